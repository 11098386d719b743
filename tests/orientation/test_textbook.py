"""Published worked examples and golden values of the orthogonal model, kept with their citation."""

from dataclasses import replace

import numpy as np
import pytest

from solvers import Block, Exterior, Image, Interior, Observations, Points
from solvers.adjustment import Options, solve
from solvers.geometry import angles
from solvers.orientation import Orthogonal, resect
from solvers.orientation.initial import planar_block, pose_of_block
from tests.synthetic import SEED_CAMERA, SEED_EXTERIOR


def textbook(c_mm: float, rows: list[list[float]], pixel_mm: float = 0.007, crs: str = "local") -> Block:
    """A block of rows x, y [mm, photo frame], X, Y, Z [m]; equal weights, control without error."""
    camera = Interior(c_mm, pixel_mm=pixel_mm, width=40000, height=40000)
    table = np.array(rows)
    n = len(table)
    return Block("textbook", crs, {"cam": camera}, (Image("a", "cam"),),
                 Points(tuple(f"P{i}" for i in range(n)), table[:, 2:], np.full((n, 3), 1e-9), ("control",) * n),
                 Observations(np.zeros(n, int), np.arange(n), camera.pixels(table[:, :2]), np.full(n, 1.0)))


MIKHAIL = [[56.515, -78.969, 913928.64, 575198.44, 189.64], [1.242, 1.134, 914270.77, 575432.35, 191.26],
           [95.576, 97.171, 914684.64, 575022.09, 186.72], [-70.988, 92.733, 914662.47, 575738.30, 191.94],
           [0.651, -30.068, 914137.97, 575435.45, 190.69]]


@pytest.mark.parametrize("pixel_mm", [0.007, 0.1])
def test_mikhail_bethel_mcglone_2001(pixel_mm):
    """Mikhail, Bethel & McGlone 2001, "Introduction to Modern Photogrammetry", single photo resection, c = 152.222 mm."""
    block = textbook(152.222, MIKHAIL, pixel_mm)
    got = resect(block, "a")
    assert np.abs(got.exterior.centre - [914260.4218628886, 575441.8355519203, 839.1304372795929]).max() < 1e-3
    degrees = np.degrees(got.exterior.angles)
    assert np.abs(degrees - [-0.3728512014027124, -0.4882633731732182, -90.25930906150649]).max() < 1e-6
    published = np.degrees([-0.006507623272946931, -0.008522026409835095, -1.5753221241359454])
    assert np.abs(degrees - published).max() < 2e-5
    assert got.sigma0 is not None and got.sigma0 * pixel_mm == pytest.approx(0.013703146344662171, rel=1e-6)
    sd = got.sigma * got.sigma0
    assert np.allclose(sd[:3], [0.14479955888891832, 0.11868322158226617, 0.06161824908394918], rtol=1e-4)
    assert np.allclose(np.degrees(sd[3:]), [0.008925234841266092, 0.01051962531018009, 0.00403060976572209], rtol=1e-4)
    assert (got.dof == 4 and not got.alternatives) or got.discrimination is None or got.discrimination > 6
    first = got.residuals[0] * [pixel_mm, -pixel_mm]  # observed minus computed, photo frame
    assert np.allclose(first, [-0.006870250818224122, -0.010088551481786112], atol=1e-6)


def test_wuhan_university_course():
    """The space resection exercise of Wuhan University (c = 153.24 mm), four points. Its angles are phi, omega, kappa with
    R = R_y(phi) R_x(omega) R_z(kappa); converted here through the matrix."""
    rows = [[-86.15, -68.99, 36589.41, 25273.32, 2195.17], [-53.40, 82.21, 37631.08, 31324.51, 728.69],
            [-14.78, -76.63, 39100.97, 24934.98, 2386.50], [10.46, 64.43, 40426.54, 30319.81, 757.31]]
    got = resect(textbook(153.24, rows), "a")
    assert np.abs(got.exterior.centre - [39795.45, 27476.46, 7572.69]).max() < 0.01
    r = got.exterior.m.T  # photo -> object
    phi_omega_kappa = [np.arctan2(-r[0, 2], r[2, 2]), -np.arcsin(r[1, 2]), np.arctan2(r[1, 0], r[1, 1])]
    assert np.abs(np.array(phi_omega_kappa) - [-0.00399, 0.00211, -0.06758]).max() < 1e-5
    assert np.abs(got.exterior.angles - [0.0021139271974502877, 0.003986923840320158, -0.0675864057974321]).max() < 1e-6
    assert got.sigma0 is not None and got.sigma0 * 0.007 == pytest.approx(0.00725942401762627, rel=1e-5)
    published = np.array([[0.9977088404720652, 0.06753643223928134, 0.003987475927949386],
                          [-0.06752840176733232, 0.9977151094696775, -0.002115488279195594],
                          [-0.004121237512782613, 0.001841373481568348, 0.9999898123206379]])
    assert np.abs(r - published).max() < 2e-5


# -- Ono & Hattori 2002, the orthogonal transformation on exact data ------------------------------------------------------

X = np.array([[-46.46175415467571, 60.589127668135674, 2.5], [-66.87445083203681, 71.35665178348098, -2.5],
              [-77.64197494738214, 50.94395510611988, 2.5], [-57.22927827002103, 40.17643099077456, -2.5]])
XY = np.array([[8.689760456847324, 3.262365851588903], [9.747637611801158, 5.541113210425716],
               [7.421659540472271, 6.8452119752637], [6.152732160464316, 4.339440699881528]])
XA = np.array([[8.570295145719207, 3.2175154148698204], [9.804027693472804, 5.573168549260785],
               [7.382922036380976, 6.809483251054305], [6.204144510923706, 4.375701151375521]])
S = 0.11627230639794202
A = np.array([0.0021601431469803994, 0.11612227379760334, -0.005495502229633348, 1.6486506688900044,
              -0.11598198454773752, 0.002527279821434685, 0.007812896528781735, -2.3438689586345207])


def printed() -> Orthogonal:
    return Orthogonal(SEED_CAMERA, X, SEED_CAMERA.pixels(XY), np.broadcast_to(np.eye(2), (4, 2, 2)), "printed", False,
                      SEED_EXTERIOR)


def test_golden_orthogonal_coordinates_scale_and_affine_parameters():
    model = printed()
    xa, _ = model.transform(SEED_EXTERIOR)
    assert np.abs(xa - XA).max() < 1e-11
    assert model.scale_of(SEED_EXTERIOR) == pytest.approx(S, rel=1e-13)
    a = A.copy()
    a[[3, 7]] += A.reshape(2, 4)[:, :3] @ X.mean(axis=0)  # the code reduces to the centroid
    assert np.abs(model.affine_of(SEED_EXTERIOR) - a).max() < 1e-12


def test_golden_exterior_orientation_from_the_affine_parameters():
    model = printed()
    a = A.copy()
    a[[3, 7]] += A.reshape(2, 4)[:, :3] @ X.mean(axis=0)
    got = model.exterior_of(a)
    assert np.abs(got.centre - SEED_EXTERIOR.centre).max() < 1e-9 and np.abs(got.m - SEED_EXTERIOR.m).max() < 1e-9


@pytest.mark.parametrize("form", ["printed", "depth"])
@pytest.mark.parametrize("recentre", [False, True])
def test_one_pass_with_the_true_orientation_returns_it(form, recentre):
    model = replace(printed(), form=form, recentre=recentre)
    trace = solve(model, model.starts()[0], Options.gauss_newton())
    got = Exterior.from_vector(trace.last.x)
    assert trace.converged and np.abs(got.centre - [0, 0, 300]).max() < 1e-9
    assert np.abs(np.degrees(angles(got.m)) - [-2.6368, 3.9069, 88.933]).max() < 1e-9


def test_golden_two_solutions_of_a_plane():
    x = np.array([[-15.486272494043183, -12.261998931003166, -0.93552730285416],
                  [-28.74417931982091, -9.923094245966052, -2.378263219683788],
                  [-16.06631617466092, -24.702509790902948, -0.3715061279209444],
                  [-15.685844511120655, -0.7663114457340487, -1.530268878825363],
                  [-34.53859812112531, -21.0318746577328, -2.4022660792258916]])
    xa = np.array([[0.9189842594847439, 4.028291982958779], [-0.08066701477649296, 5.130326124237992],
                   [0.11121508498371924, 3.023349789836218], [1.6020393140220743, 5.007157868663103],
                   [-1.2565157666348972, 4.593396715609592]])
    wanted = [np.array([[0.7495962650805189, 0.5705401655735413, 0.3355433784842916],
                        [-0.6313762241158433, 0.7685041868185798, 0.10375634179911086],
                        [-0.1986693307950598, -0.28962947762551655, 0.9362933635841992]]),
              np.array([[0.8067045634024779, 0.5419860164125618, -0.235539604735297],
                        [-0.5908193503278679, 0.7482257499245922, -0.3018123960806407],
                        [0.012658699134332901, 0.3826347934558799, 0.9238129530230688]])]
    u, s, vt = np.linalg.svd(x - x.mean(axis=0), full_matrices=False)
    got = [pose_of_block(planar_block(xa - xa.mean(axis=0), u, s, vt, sign)) for sign in (1.0, -1.0)]
    assert all(scale == pytest.approx(0.11, abs=1e-11) for _, scale in got)
    for m in wanted:
        assert min(np.abs(m - g).max() for g, _ in got) < 1e-10


def test_golden_derivative_by_the_principal_distance():
    """d x_a / d c of the first point: the printed partial (15), (16), and the total one that the iteration needs."""
    from solvers.orientation.orthogonal_c import by_principal_distance

    model = printed()
    partial, total = (by_principal_distance(model, SEED_EXTERIOR, total=t)[0] for t in (False, True))
    assert np.abs(partial - [0.0013369641292596509, 0.0005019316863515022]).max() < 1e-12
    assert np.abs(total - [0.0033946580417972758, 0.0012744443910021196]).max() < 1e-12
