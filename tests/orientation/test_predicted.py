"""Predicted standard errors of every model against independent values, for the clusters of the published design.

Each row: cluster centre in the photo [mm], points, field of view [deg], relief [m]; then omega, phi, kappa [deg] and
X, Y, Z [m] for perspective, one orthogonal pass re-centred, one pass as printed; spectral radii of both; perspective with
a prior of 0.1 degrees and 1 m. Image noise 0.3 px, control 2 mm.
"""

import numpy as np
import pytest

from solvers.adjustment import precision
from solvers.cameras import project
from solvers.orientation import Orthogonal, Resection, resect, resect_orthogonal
from solvers.orientation.control import Control
from tests.checks import chi_square_band, normalised_error
from tests.synthetic import SEED_CAMERA, SEED_EXTERIOR, block_of, cluster, prior_of

ROWS = [
    ((0.0, 0.0), 4, 0.5, 1.0, [0.58574, 0.58981, 0.22663, 3.08735, 3.06505, 1.22766],
     [0.58845, 0.58705, 0.22663, 3.07295, 3.07932, 1.22706], [0.58845, 0.58705, 0.22663, 3.07295, 3.07932, 1.22706],
     0.0057, 0.0057, [0.08756, 0.08754, 0.09138, 0.46149, 0.4597, 0.76207]),
    ((0.0, 0.0), 4, 2, 5.0, [0.11625, 0.11948, 0.05652, 0.62571, 0.60847, 0.30185],
     [0.11796, 0.11766, 0.05653, 0.61614, 0.61737, 0.30159], [0.11796, 0.11766, 0.05653, 0.61614, 0.61737, 0.30159],
     0.0184, 0.0184, [0.07042, 0.07112, 0.04908, 0.37282, 0.36876, 0.28496]),
    ((0.0, 0.0), 4, 6, 0.0, [0.38367, 0.38536, 0.02452, 2.01796, 2.00954, 0.26704],
     [0.45634, 0.45532, 0.02653, 2.38103, 2.38689, 0.30997], [0.45572, 0.4547, 0.02652, 2.37775, 2.38362, 0.30997],
     0.0014, 0.0, [0.08624, 0.08623, 0.01873, 0.45162, 0.45173, 0.1123]),
    ((0.0, 0.0), 4, 6, 1.0, [0.28505, 0.4371, 0.02459, 2.28816, 1.48974, 0.29995],
     [0.36104, 0.35898, 0.02384, 1.87724, 1.88845, 0.25207], [0.36073, 0.35868, 0.02384, 1.8756, 1.88682, 0.25218],
     0.3088, 0.3084, [0.08417, 0.08656, 0.01873, 0.45332, 0.44084, 0.11249]),
    ((0.0, 0.0), 4, 6, 5.0, [0.10286, 0.13212, 0.01938, 0.69166, 0.53818, 0.13025],
     [0.11449, 0.11403, 0.0193, 0.5963, 0.59885, 0.12244], [0.11448, 0.11402, 0.0193, 0.59624, 0.5988, 0.12249],
     0.1562, 0.1562, [0.06678, 0.07331, 0.01863, 0.38388, 0.34968, 0.10848]),
    ((0.0, 0.0), 4, 20, 0.0, [0.05699, 0.05795, 0.00604, 0.3078, 0.30276, 0.04689],
     [0.13752, 0.13733, 0.00792, 0.71813, 0.71926, 0.09218], [0.13545, 0.13526, 0.00788, 0.70724, 0.70841, 0.09218],
     0.0153, 0.0, [0.04787, 0.04843, 0.00589, 0.25726, 0.25434, 0.04235]),
    ((0.0, 0.0), 4, 40, 1.0, [0.01414, 0.01495, 0.00276, 0.08354, 0.079, 0.0168],
     [0.06915, 0.06886, 0.00386, 0.36002, 0.36156, 0.04427], [0.06515, 0.06489, 0.00379, 0.33915, 0.34058, 0.04431],
     0.6066, 0.4854, [0.01396, 0.01473, 0.00276, 0.08234, 0.07799, 0.01673]),
    ((0.0, 0.0), 10, 0.5, 5.0, [0.13755, 0.13702, 0.22289, 0.73646, 0.70126, 1.16321],
     [0.13745, 0.13711, 0.22287, 0.7372, 0.70079, 1.1633], [0.13743, 0.1371, 0.22286, 0.73713, 0.7007, 1.1634],
     0.0011, 0.0013, [0.07291, 0.07257, 0.09002, 0.38731, 0.37806, 0.73366]),
    ((0.0, 0.0), 10, 6, 0.0, [0.34208, 0.35091, 0.02164, 1.8349, 1.78907, 0.26942],
     [0.39766, 0.39658, 0.02225, 2.07258, 2.08026, 0.28395], [0.40278, 0.40171, 0.02198, 2.0999, 2.10683, 0.28356],
     0.1476, 0.1589, [0.08563, 0.08572, 0.01648, 0.44838, 0.44822, 0.10375]),
    ((0.0, 0.0), 10, 20, 1.0, [0.05545, 0.05213, 0.00549, 0.27482, 0.29206, 0.04726],
     [0.11096, 0.11062, 0.0069, 0.57789, 0.5806, 0.08238], [0.11415, 0.11376, 0.00661, 0.59476, 0.59706, 0.08143],
     0.5377, 0.5165, [0.0469, 0.04481, 0.00531, 0.23626, 0.24707, 0.04217]),
    ((0.0, 0.0), 10, 40, 5.0, [0.01465, 0.01304, 0.00248, 0.07085, 0.07906, 0.01588],
     [0.04886, 0.04873, 0.00352, 0.25445, 0.25578, 0.03795], [0.04988, 0.04962, 0.00319, 0.25951, 0.26086, 0.03649],
     1.269, 1.2394, [0.01445, 0.0129, 0.00248, 0.07007, 0.07799, 0.0158]),
    ((8.0, 5.0), 4, 2, 0.0, [0.39267, 0.38789, 0.08658, 2.03855, 2.05195, 0.8952],
     [0.39356, 0.38875, 0.08668, 2.04269, 2.05626, 0.89703], [1.3214, 1.31843, 0.07615, 6.89099, 6.90842, 0.89955],
     0.0002, 3.2771, [0.08561, 0.08519, 0.04867, 0.45023, 0.44982, 0.32769]),
    ((8.0, 5.0), 4, 6, 0.0, [0.12864, 0.12712, 0.02858, 0.66908, 0.67315, 0.29341],
     [0.13125, 0.12964, 0.02887, 0.68122, 0.68578, 0.29878], [0.44011, 0.43915, 0.02536, 2.29529, 2.30092, 0.29962],
     0.0014, 3.2771, [0.07238, 0.0718, 0.02139, 0.37803, 0.37892, 0.18305]),
    ((8.0, 5.0), 4, 6, 1.0, [0.12159, 0.1283, 0.02875, 0.67647, 0.63738, 0.28234],
     [0.12784, 0.12643, 0.02845, 0.66442, 0.66805, 0.29186], [0.35151, 0.35181, 0.02293, 1.83886, 1.83762, 0.24623],
     0.0423, 2.0915, [0.07103, 0.07199, 0.02142, 0.37922, 0.37209, 0.18094]),
    ((8.0, 5.0), 4, 6, 5.0, [0.08053, 0.09357, 0.02447, 0.49521, 0.42424, 0.20055],
     [0.08662, 0.08643, 0.02358, 0.45524, 0.45355, 0.20682], [0.11308, 0.11466, 0.01865, 0.59985, 0.59137, 0.11971],
     0.0957, 0.3664, [0.05912, 0.06359, 0.02074, 0.33606, 0.31091, 0.1586]),
    ((8.0, 5.0), 10, 0.5, 5.0, [0.16863, 0.15062, 0.22867, 1.01721, 1.06216, 0.9382],
     [0.16844, 0.15087, 0.22872, 1.01949, 1.06067, 0.93803], [0.13634, 0.13791, 0.21468, 0.91889, 0.85719, 1.12776],
     0.0019, 0.3094, [0.07537, 0.07289, 0.08851, 0.43768, 0.44754, 0.62782]),
    ((8.0, 5.0), 10, 6, 0.0, [0.11735, 0.1076, 0.02643, 0.56878, 0.61629, 0.24967],
     [0.1146, 0.11326, 0.0266, 0.59707, 0.60072, 0.2589], [0.38931, 0.38767, 0.02102, 2.02379, 2.03377, 0.27431],
     0.0437, 3.3038, [0.07019, 0.06749, 0.01998, 0.35638, 0.36844, 0.16856]),
]


def control(points: np.ndarray, sigma_px: float = 0.3, sigma_m: float = 0.002) -> Control:
    n = len(points)
    return Control("a", SEED_CAMERA, tuple(f"P{i}" for i in range(n)), points, project(SEED_CAMERA, SEED_EXTERIOR, points),
                   np.full(n, sigma_px), np.full((n, 3), sigma_m))


def listed(covariance: np.ndarray) -> np.ndarray:
    """omega, phi, kappa [deg], X, Y, Z [m] of a covariance in (centre, left rotation vector)."""
    sd = np.sqrt(np.diag(SEED_EXTERIOR.angle_covariance(covariance)))
    return np.concatenate([np.degrees(sd[3:]), sd[:3]])


@pytest.mark.parametrize("row", ROWS, ids=lambda r: f"{r[0]}-n{r[1]}-fov{r[2]}-relief{r[3]}")
def test_standard_errors(row):
    centre, n, fov, relief, sd_p, sd_rc, sd_12, rho_rc, rho_12, sd_b = row
    known = control(cluster(centre, n, fov, relief))
    weights = known.weights(SEED_EXTERIOR)
    perspective = Resection(SEED_CAMERA, known.points, known.pixels, weights)
    c_p = precision(perspective.linear(perspective.start(SEED_EXTERIOR))).covariance
    assert np.allclose(listed(c_p), sd_p, rtol=0.01)
    for recentre, sd, rho in ((True, sd_rc, rho_rc), (False, sd_12, rho_12)):
        model = Orthogonal(SEED_CAMERA, known.points, known.pixels, np.linalg.inv(weights), "printed", recentre)
        leak = model.statistics(SEED_EXTERIOR)
        assert np.allclose(listed(leak.noise), sd, rtol=0.01)
        assert leak.radius == pytest.approx(rho, rel=0.02, abs=0.01)
    prior = np.diag([1.0] * 3 + [np.radians(0.1)] * 3) ** 2
    c_b = np.linalg.inv(np.linalg.inv(SEED_EXTERIOR.angle_covariance(c_p)) + np.linalg.inv(prior))
    sd = np.sqrt(np.diag(c_b))
    assert np.allclose(np.concatenate([np.degrees(sd[3:]), sd[:3]]), sd_b, rtol=0.01)


@pytest.mark.parametrize("row", ROWS[::4], ids=lambda r: f"{r[0]}-n{r[1]}-fov{r[2]}-relief{r[3]}")
def test_a_solution_states_those_standard_errors(row):
    block = block_of(cluster(*row[:4]), SEED_EXTERIOR, prior=prior_of(SEED_EXTERIOR, 0.1, 1.0))
    for sd, options in ((row[4], {}), (row[9], {"prior": "weighted"})):
        got = resect(block, "a", **options)
        assert np.allclose(np.concatenate([np.degrees(got.sigma[3:]), got.sigma[:3]]), sd, rtol=0.012)


@pytest.mark.parametrize("form, recentre", [("printed", False), ("depth", True)])
def test_one_pass_with_a_perfect_approximation_scatters_as_predicted(form, recentre):
    points = cluster((8.0, 5.0), n=8, fov_deg=10, relief=5)
    errors = []
    for seed in range(40):
        block = block_of(points, SEED_EXTERIOR, noise_px=0.3, noise_m=0.002, seed=seed, prior=prior_of(SEED_EXTERIOR, 1e-9, 1e-9))
        got = resect_orthogonal(block, "a", one_pass=True, form=form, recentre=recentre)
        gap = normalised_error(got, SEED_EXTERIOR)
        errors.append(gap @ np.linalg.solve(got.covariance, gap))
    chi_square_band(np.array(errors), 6)


def test_one_pass_with_an_honest_prior_scatters_as_predicted():
    """C_n + K Sigma_0 K^T: errors of the approximation come through as the leak says."""
    points, rng = cluster(n=6, fov_deg=6, relief=5), np.random.default_rng(5)
    errors = []
    for seed in range(40):
        block = block_of(points, SEED_EXTERIOR, noise_px=0.3, noise_m=0.002, seed=seed,
                         prior=prior_of(SEED_EXTERIOR, 0.2, 2.0, rng))
        got = resect_orthogonal(block, "a", one_pass=True)
        gap = normalised_error(got, SEED_EXTERIOR)
        errors.append(gap @ np.linalg.solve(got.covariance, gap))
    chi_square_band(np.array(errors), 6)
