"""Reports: their numbers are those of the run, nothing is fetched, nothing written is read as markup, accuracy in the
standard's words."""

from __future__ import annotations

import html as entities
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from solvers import Block, Observations, Points
from solvers.cli import main
from solvers.errors import BadProject, Unsupported
from solvers.report_accuracy import Accuracy, remarks, statements
from solvers.report_contents import contents
from solvers.report_document import Document, Section, Table, Words
from solvers.report_html import html
from solvers.report_material import Material, Wanted
from solvers.report_pdf import pdf
from solvers.workflows_report import material, report_project

DEMO = Path(__file__).parent.parent / "assets" / "demo"


@pytest.fixture(scope="module")
def adjusted(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "demo"
    shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("runs"))
    assert main(["adjust", str(folder), "--quiet"]) == 0
    return folder, next((folder / "runs").iterdir())


@pytest.fixture(scope="module")
def page(adjusted):
    folder, _ = adjusted
    assert main(["report", str(folder), "-o", str(folder / "r.html"), "--quiet"]) == 0
    return (folder / "r.html").read_text(encoding="utf-8")


def at(result, pointer):
    for word in pointer.split("/")[1:]:
        word = word.replace("~1", "/").replace("~0", "~")
        result = result[int(word)] if isinstance(result, list) else result[word]
    return result


def test_every_number_is_the_run_s(adjusted, page):
    result = json.loads((adjusted[1] / "result.json").read_text())
    cells = re.findall(r'data-key="([^"]+)" data-value="([^"]+)">([^<]+)</td>', page)
    assert len(cells) > 400
    for key, value, shown in cells:
        true = at(result, entities.unescape(key))
        assert float(value) == true
        decimals = len(shown.partition(".")[2])
        assert abs(float(shown.replace("−", "-")) - true) <= 0.5000001 * 10.0**-decimals or "e" in shown
    assert {"/orientations/0/X", "/orientations/4/sigma/kappa_deg", "/check_rms_m/2"} <= {k for k, _, _ in cells}


def test_the_accuracy_is_that_of_the_check_points(adjusted, page):
    result = json.loads((adjusted[1] / "result.json").read_text())
    off = np.array([[p["dX"], p["dY"], p["dZ"]] for p in result["points"] if p["role"] == "check"])
    h = np.sqrt((off[:, :2] ** 2).sum(axis=1).mean() + 2 * 0.002**2) * 100
    assert f"RMSEH = {h:.1f} (cm) using the reduced number of checkpoints" in page
    assert f"using ONLY {len(off)} checkpoints" in page


def test_the_page_stands_alone_and_warns_first(page):
    assert not re.search(r'(?:src|href)="(?!data:)|url\(|@import|<script|https?://(?!www\.w3\.org)', page)
    headings = re.findall(r"<h2>([^<]+)</h2>", page)
    assert headings[0] == "Warnings" and {"Positional accuracy", "Redundancy and blunder tests", "Iterations"} <= set(headings)
    assert page.count("data:image/svg+xml;base64,") >= 6


def test_a_resection_is_reported_by_its_rays(adjusted, tmp_path):
    folder = tmp_path / "demo"
    shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("runs"))
    assert main(["resect", str(folder), "--image", "DSC00229", "DSC00230", "--quiet"]) == 0
    run = next((folder / "runs").iterdir())
    m = material(folder, run)
    assert len(m.grounds) == 2 * 39 and set(m.outlines or {}) == {"DSC00229", "DSC00230"}
    off = np.array([g.off for g in m.grounds])
    scale = np.array([np.sqrt(np.diag(g.covariance)) for g in m.grounds])
    assert 0.7 < np.sqrt(((off / scale) ** 2).mean()) < 1.3  # the ellipses predict the differences
    document = contents(m, Wanted())
    text = " ".join(p.text for s in document.sections for p in s.parts if isinstance(p, Words))
    assert "correlated" in text and "No statement is made" in text and "alike for" in text


def test_the_pdf_is_set(adjusted, tmp_path):
    assert report_project(adjusted[1], tmp_path / "r.pdf").run == adjusted[1]
    data = (tmp_path / "r.pdf").read_bytes()
    assert data.startswith(b"%PDF-") and len(data) > 50_000


NASTY = '<b>"x"</b> & #import "y" $1$ \\ ] *a* {{ 7 * 7 }}'


def test_names_are_never_markup():
    sections = [Section(NASTY, [Words(NASTY, "warning"), Table((NASTY,), [(NASTY,)], NASTY, NASTY)])]
    document = Document(NASTY, {NASTY: NASTY}, sections)
    page = html(document)
    assert "<b>" not in page and page.count(entities.escape(NASTY, quote=False).split("&amp;")[0].replace('"', "&#34;")) >= 6
    assert pdf(document).startswith(b"%PDF-")


# -- accuracy ---------------------------------------------------------------------------------------------------------------


def errors(n, seed=1):
    return np.random.default_rng(seed).normal(0, [0.03, 0.04, 0.06], (n, 3))


def test_edition_1_states_the_95_percent_level():
    off = errors(25)
    a = Accuracy.of(off, np.full((25, 3), 0.01))
    horizontal, vertical = statements(a, "2014", 5, 10)
    r = np.sqrt((off**2).mean(axis=0))
    assert f"+/- {1.7308 * np.hypot(r[0], r[1]) * 100:.1f} (cm) at 95% confidence level" in horizontal
    assert f"+/- {1.96 * r[2] * 100:.1f} (cm) at 95% confidence level" in vertical
    assert "NOT meet" not in horizontal + vertical and not [x for x in remarks(a, "2014", 5, 10) if "Only" in x]


def test_edition_2_adds_the_survey_and_asks_for_thirty():
    off = errors(40)
    a = Accuracy.of(off, np.full((40, 3), 0.02))
    assert a.horizontal("2024") == pytest.approx(np.sqrt((off[:, :2] ** 2).mean(axis=0).sum() + 2 * 0.02**2))
    horizontal, vertical = statements(a, "2024", 4, 10)
    assert "tested to meet" in horizontal and horizontal.endswith("The test does NOT meet this class.")
    assert f"RMSEV = {100 * a.vertical('2024'):.1f} (cm)" in vertical and "NOT" not in vertical
    few = statements(Accuracy.of(off[:12], np.full((12, 3), 0.02)), "2023", 6, 10)[0]
    assert "minimum of thirty (30) checkpoints" in few and "ONLY 12" in few and "Edition 2 (2023)" in few


def test_the_sentences_are_those_of_each_edition():
    """Edition 2 as its section 7.16 is quoted in public; edition 1 with the class names of published metadata."""
    many = Accuracy.of(np.tile([[0.03, 0.04, 0.05], [-0.03, -0.04, -0.05]], (20, 1)), np.zeros((40, 3)))
    few = Accuracy.of(np.tile([[0.03, 0.04, 0.05], [-0.03, -0.04, -0.05]], (5, 1)), np.zeros((10, 3)))
    title = "ASPRS Positional Accuracy Standards for Digital Geospatial Data"
    assert statements(many, "2024", 5, 5) == [
        f"This data set was tested to meet {title}, Edition 2, Version 2 (2024) for a 5 (cm) RMSEH Horizontal Positional "
        "Accuracy Class. The tested horizontal positional accuracy was found to be RMSEH = 5.0 (cm).",
        f"This data set was tested to meet {title}, Edition 2, Version 2 (2024) for a 5 (cm) RMSEV Vertical Accuracy Class. The "
        "Non-Vegetated Vertical Accuracy (NVA) was found to be RMSEV = 5.0 (cm)."]
    assert statements(few, "2024", 5, 5)[0] == (
        f"This data set was tested as required by {title}, Edition 2, Version 2 (2024). Although the Standards call for a "
        "minimum of thirty (30) checkpoints, this test was performed using ONLY 10 checkpoints. This data set was "
        "produced to meet a 5 (cm) RMSEH Horizontal Positional Accuracy Class. The tested horizontal positional accuracy was "
        "found to be RMSEH = 5.0 (cm) using the reduced number of checkpoints.")
    assert statements(many, "2023", 5, 5)[1].endswith("RMSEV Vertical Accuracy Class. "
                                                      "NVA accuracy was found to be RMSEV = 5.0 (cm).")
    assert statements(many, "2014", 5, 5) == [
        f"This data set was tested to meet {title} (2014) for a 5 (cm) RMSEx / RMSEy Horizontal Accuracy Class. Actual "
        "positional accuracy was found to be RMSEx = 3.0 (cm) and RMSEy = 4.0 (cm) which equates to Positional Horizontal "
        "Accuracy = +/- 8.7 (cm) at 95% confidence level.",
        f"This data set was tested to meet {title} (2014) for a 5 (cm) RMSEz Vertical Accuracy Class. Actual NVA accuracy was "
        "found to be RMSEz = 5.0 (cm), equating to +/- 9.8 (cm) at 95% confidence level."]


def test_a_class_that_nobody_gave_is_said_to_be_chosen_afterwards():
    assert "chosen after it" in statements(Accuracy.of(errors(40), np.zeros((40, 3))))[2]


def test_a_mean_error_and_a_weak_survey_are_named():
    a = Accuracy.of(errors(40) + np.array([0, 0, 0.08]), np.full((40, 3), 0.03))
    said = " ".join(remarks(a, "2024", 5, 10))
    assert "mean error in Z" in said and "mean error in X" not in said and "2 times better" in said


# -- bad input --------------------------------------------------------------------------------------------------------------


def test_what_cannot_be_reported_is_refused(adjusted, tmp_path, capsys):
    folder = tmp_path / "demo"
    shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("runs"))
    with pytest.raises(BadProject, match="no run to report on; make one with: collinea adjust"):
        report_project(folder, tmp_path / "r.html")
    with pytest.raises(Unsupported, match=r"\.html or \.pdf"):
        report_project(adjusted[0], tmp_path / "r.docx")
    run = folder / "runs" / "20260101-000000-adjust"
    run.mkdir(parents=True)
    (run / "result.json").write_text("{")
    assert main(["report", str(run), "-o", str(tmp_path / "r.html")]) == 1
    assert "result.json" in capsys.readouterr().err and not (tmp_path / "r.html").exists()


def test_the_quality_of_a_mosaic_has_its_units():
    from solvers.report_mosaic_quality import mosaic

    result = {"kind": "semicontrolled", "register": "simultaneous", "width": 70, "height": 50, "gsd": 0.016, "unit": "m",
              "bounds": [1.0, 2.0, 3.0, 4.0], "rms_px": 1.7, "seam_rms": 2.9, "seams": {"places": 34}, "check_rms_m": None,
              "check_ties": {"count": 163, "rms_px": 2.1, "p90_px": 3.5, "median_px": 1.1},
              "headings": [{"image": "a", "correction_deg": 177.1}],
              "images": [{"name": "a", "used": True, "why": "", "sigma": 5.2, "sigma_px": 326.7},
                         {"name": "b", "used": False, "why": "no tie points"}]}
    block = Block("p", "local", {}, (), Points((), np.empty((0, 3)), np.empty((0, 3)), ()),
                  Observations(np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty(0)))
    section = mosaic(Material(block, "mosaic", "run", "", "", {}, {}, mosaic=result, mosaic_run="run"))
    assert section is not None
    quality, photos = section.parts
    assert isinstance(quality, Table) and isinstance(photos, Table)
    told = {k: str(v) for k, v in quality.rows}
    assert told["neighbours along the seams, rms [px]"] == "2.90" and told["check ties, 90 % within [px]"] == "3.50"
    assert told["predicted standard error of places, photo by photo [m]"] == "5.2 to 5.2" and told["check points, rms [m]"] == \
        "none measured"
    assert [str(c) for c in photos.rows[0]] == ["a", "yes", "5.20", "326.7", "177.1"]
    assert [str(c) for c in photos.rows[1]] == ["b", "no: no tie points", "–", "–", "–"]
    assert quality.right == (False, False) and photos.right == (False, False, True, True, True)


def test_warnings_that_differ_by_a_number_are_all_told():
    from solvers.report_contents import grouped

    weak = [(f"{i}, perspective", f"weak by {n}") for n, i in enumerate("abc")]
    assert grouped([("", "yaw of D1 is off"), ("", "yaw of D2 is off"), ("", "yaw of D1 is off"), *weak]) == [
        "yaw of D1 is off", "yaw of D2 is off", "a, perspective: weak by 0 (alike for b, perspective, c, perspective)"]


def test_a_mosaic_alone_is_reported(tmp_path):
    folder = tmp_path / "demo"
    shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("runs"))
    run = folder / "runs" / "20260101-000000-mosaic"
    run.mkdir(parents=True)
    (run / "result.json").write_text(json.dumps({
        "kind": "uncontrolled", "register": "simultaneous", "width": 70, "height": 50, "gsd": 0.016, "unit": "m", "rms_px": 1.7,
        "bounds": [652300.0, 5401200.0, 652301.12, 5401200.8], "seam_rms": 2.9,
        "warnings": ["photos are bent by 6 px"], "images": [{"name": "DSC00229", "used": True, "sigma": 5.2}]}))
    made = report_project(folder, tmp_path / "r.html")
    assert made.run == run and made.sections[0] == "Warnings" and "Mosaic" in made.sections and made.warnings == 1
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert page.count("photos are bent by 6 px") == 1 and "1.70" in page and "The mosaic, reduced" not in page
    (run / "mosaic.png").write_bytes(b"no picture")
    report_project(folder, tmp_path / "r.html")
    assert "The mosaic, reduced" not in (tmp_path / "r.html").read_text(encoding="utf-8")
    Image.new("RGBA", (70, 50), (200, 90, 20, 255)).save(run / "mosaic.png")
    report_project(folder, tmp_path / "r.html")
    assert "The mosaic, reduced" in (tmp_path / "r.html").read_text(encoding="utf-8")
    report_project(folder, tmp_path / "r.pdf")
