"""Lists of control points as people have them: any delimiter, decimal sign, encoding and order of columns, and ODM's list."""

from pathlib import Path

import numpy as np
import pytest

from solvers import BadTable
from solvers.io import ControlList, read_control

XYZ = [[684210.5, 5334100.25, 412.125], [684310.75, 5334180.5, 418.0], [684250.0, 5334020.0, 415.5]]


def read(at: Path, text: str, encoding: str = "utf-8", **options: object) -> ControlList:
    path = at / "list.txt"
    path.write_bytes(text.encode(encoding))
    return read_control(path, **options)  # type: ignore[arg-type]


def same(control: ControlList, names: str = "P1 P2 P3") -> None:
    assert control.names == tuple(names.split()) and control.role == ("control",) * 3
    np.testing.assert_array_equal(control.xyz, XYZ)


TABLES = {
    "plain": "name,X,Y,Z\nP1,684210.5,5334100.25,412.125\nP2,684310.75,5334180.5,418\nP3,684250,5334020,415.5\n",
    "order": "Height,Northing,Label,Easting\n412.125,5334100.25,P1,684210.5\n418,5334180.5,P2,684310.75\n"
             "415.5,5334020,P3,684250\n",
    "semicolon decimal comma": "Punkt;Rechtswert;Hochwert;Höhe\nP1;684210,5;5334100,25;412,125\nP2;684310,75;5334180,5;418\n"
                               "P3;684250;5334020;415,5\n",
    "semicolon decimal point": "Nr;E [m];N [m];H [m]\n"
                               "P1;684210.5;5334100.25;412.125\nP2;684310.75;5334180.5;418\nP3;684250;5334020;415.5\n",
    "tab": "id\teast\tnorth\televation\nP1\t684210.5\t5334100.25\t412.125\nP2\t684310.75\t5334180.5\t418\n"
           "P3\t684250\t5334020\t415.5\n",
    "tab decimal comma": "id\tx\ty\tz\nP1\t684210,5\t5334100,25\t412,125\nP2\t684310,75\t5334180,5\t418\n"
                         "P3\t684250\t5334020\t415,5\n",
    "blanks": "name   X          Y          Z\nP1  684210.5   5334100.25 412.125\n\nP2  684310.75  5334180.5  418\nP3  684250    "
              " 5334020    415.5\n",
    "header in a comment": "# made by hand\n# Label, X, Y, Z\nP1, 684210.5, 5334100.25, 412.125\nP2, 684310.75, 5334180.5, 418\n"
                           "P3, 684250, 5334020, 415.5\n",
    "quotes": '"name","X","Y","Z"\n"P1","684210.5","5334100.25","412.125"\n"P2","684310.75","5334180.5","418"\n'
              '"P3","684250","5334020","415.5"\n',
}


@pytest.mark.parametrize("text", TABLES.values(), ids=TABLES.keys())
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_tables_of_any_make(tmp_path: Path, text: str, encoding: str, end: str) -> None:
    control = read(tmp_path, text.replace("\n", end), encoding)
    same(control)
    assert any(note.startswith("columns: name = ") for note in control.notes)


def test_measurements_and_sigmas(tmp_path: Path) -> None:
    control = read(tmp_path, "gcp_label,image,x,y,x_map,y_map,elev,x_map_acc,y_map_acc,elev_acc\n"
                             "P1,a.jpg,100.5,200.25,684210.5,5334100.25,412.125,0.01,0.02,0.03\n"
                             "P1,b.jpg,300,400,684210.5,5334100.25,412.125,0.01,0.02,0.03\n"
                             "P2,a.jpg,7,8,684310.75,5334180.5,418,0.01,0.02,0.03\n")
    assert control.names == ("P1", "P2") and control.sigma.tolist() == [[0.01, 0.02, 0.03]] * 2
    assert [(m.point, m.image, m.col, m.row) for m in control.marks] == [
        ("P1", "a.jpg", 100.5, 200.25), ("P1", "b.jpg", 300, 400), ("P2", "a.jpg", 7, 8)]


def test_degrees_name_their_crs(tmp_path: Path) -> None:
    control = read(tmp_path, "label,lat,lon,alt\nP1,48.1,11.5,520\nP2,48.2,11.6,530\n")
    assert control.crs == "EPSG:4326" and control.xyz[0].tolist() == [11.5, 48.1, 520.0]  # longitude first


def test_mapping_by_name_or_number(tmp_path: Path) -> None:
    text = "who,a,b,c\nP1,684210.5,5334100.25,412.125\nP2,684310.75,5334180.5,418\nP3,684250,5334020,415.5\n"
    same(read(tmp_path, text, mapping="name=who,X=a,Y=b,Z=c"))
    same(read(tmp_path, text, mapping="name=1, X=2, Y=3, Z=4"))
    same(read(tmp_path, text.split("\n", 1)[1], mapping="name=1,X=2,Y=3,Z=4"))


def test_a_person_is_asked_when_columns_are_unclear(tmp_path: Path) -> None:
    asked = []

    def ask(question: str) -> str:
        asked.append(question)
        return {"name": "1", "X": "nonsense", "Y": "3", "Z": "4"}[question.split()[-1].rstrip("?")] if len(asked) != 3 else "2"

    same(read(tmp_path, TABLES["plain"].split("\n", 1)[1], ask=ask))
    assert len(asked) == 5 and "1: P1" in asked[0]  # one answer was no column and was asked again


@pytest.mark.parametrize(("text", "says"), [
    ("P1,684210.5,5334100.25,412.125\nP2,1,2,3\n", ["line 1", "there is no header line", '--map "name=1,X=2,Y=3,Z=4"']),
    ("id,name,X,Y,Z\n1,P1,1,2,3\n", ["line 2", "for name there is 'id' and 'name'", '--map "name=id,X=X,Y=Y,Z=Z"']),
    ("name,X,Y\nP1,1,2\n", ["line 2", "for Z there is none", "--map"]),
    ("name,X,Y,Z\nP1,abc,2,3\n", ["line 2", "X is 'abc'"]),
    ("name,X,Y,Z\nP1,nan,2,3\n", ["line 2", "X is 'nan'"]),
    ("name,X,Y,Z\nP1,1,2,3\nP1,4,5,6\n", ["line 3", "'P1' is already in line 2"]),
    ("name,X,Y,Z\nP1,1,2,3\nP2,4,5\n", ["line 3", "3 cells where line 1 has 4"]),
    ("name,X,Y,Z\nP1,684210,5,5334100,25,412,125\nP2,684310,75,5334180,5,418,0\n", ["commas are both"]),
    ("name;X;Y;Z\nP1;12.34,5;2;3\n", ["line 2", "X is '12.34,5'"]),
    ("name,X,Y,Z,sX\nP1,1,2,3,-1\n", ["line 2", "sX is -1"]),
    ("", ["empty"]), ("# only\n# comments\n", ["only comments"]), ("name,X,Y,Z\n", ["no line below"]),
    ("hello\n", ["line 1", "not cut into columns"]),
    ("name,image,X,Y,Z,col,row\nP1,a,1,2,3,4,5\nP1,a,1,2,3,6,7\n", ["line 3", "'P1' in image 'a' is already in line 2"]),
    ("name,image,X,Y,Z,col,row\nP1,a,1,2,3,4,5\nP1,b,1,2,9,6,7\n", ["line 3", "'P1' is already in line 2"]),
])
def test_unclear_or_wrong_lists_are_refused_with_the_cure(tmp_path: Path, text: str, says: list[str]) -> None:
    with pytest.raises(BadTable) as error:
        read(tmp_path, text)
    for part in ["list.txt", *says]:
        assert part in str(error.value)


@pytest.mark.parametrize("mapping", ["name=who", "who=name,X=X,Y=Y,Z=Z", "name=name,X=9,Y=Y,Z=Z", "name=name,X=X,Y=Y",
                                     "name=name,X=X,Y=Y,Z=Z,col=X"])
def test_wrong_mappings(tmp_path: Path, mapping: str) -> None:
    with pytest.raises(BadTable, match="--map"):
        read(tmp_path, TABLES["plain"], mapping=mapping)


def test_no_text(tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_bytes(bytes(range(256)) * 10)
    with pytest.raises(BadTable, match="not a text file"):
        read_control(tmp_path / "list.txt")


# -- ODM gcp_list.txt -------------------------------------------------------------------------------------------------------

ODM = """\ufeffWGS84 UTM 32N
# a comment
684210.5 5334100.25 412.125 100.5 200.25 a.jpg P1 extra words
684210.5\t5334100.25\t412.125 300 400 b.jpg P1

684310.75 5334180.5 418 7 8 a.jpg P2
684250 5334020 415.5 9 10 a.jpg P3
"""


def test_odm_list(tmp_path: Path) -> None:
    control = read(tmp_path, ODM)
    same(control)
    assert control.crs == "EPSG:32632" and len(control.marks) == 4 and control.marks[1].image == "b.jpg"


@pytest.mark.parametrize(("line", "crs"),
                         [("EPSG:25832", "EPSG:25832"), ("epsg: 25832", "EPSG:25832"), ("WGS84 UTM 22S", "EPSG:32722"),
                                           ("+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs", None)])
def test_odm_crs(tmp_path: Path, line: str, crs: str | None) -> None:
    assert read(tmp_path, line + "\n1 2 3 4 5 a.jpg P1\n").crs == (crs or line)


def test_odm_points_without_names_are_told_apart_by_their_coordinate_text(tmp_path: Path) -> None:
    control = read(tmp_path, "EPSG:25832\n1 2 3 4 5 a.jpg\n1 2 3 6 7 b.jpg\n9 2 3 4 5 a.jpg\n")
    assert control.names == ("gcp1", "gcp2") and [m.point for m in control.marks] == ["gcp1", "gcp1", "gcp2"]


def test_odm_without_height_is_a_tie_point(tmp_path: Path) -> None:
    control = read(tmp_path, "EPSG:25832\n1 2 NaN 4 5 a.jpg P1\n1 3 4 4 5 b.jpg P2\n")
    assert control.role == ("tie", "control") and np.isnan(control.xyz[0]).all() and "P1" in control.notes[0]


@pytest.mark.parametrize(("lines", "says"), [
    ("1 2 3 4 5", ["line 2", "5 items"]),
    ("1 2 x 4 5 a.jpg P1", ["line 2", "Z is 'x'"]),
    ("1 2 3 4 nan a.jpg P1", ["line 2", "row is 'nan'"]),
    ("1 2 3 4 5 a.jpg P1\n1 2 3.0 6 7 b.jpg P1", ["line 3", "other coordinates than in line 2"]),
    ("1 2 3 4 5 a.jpg P1\n1 2 3 6 7 a.jpg P1", ["line 3", "already in line 2"]),
    ("# nothing", ["no control point"]),
])
def test_odm_lists_that_are_wrong(tmp_path: Path, lines: str, says: list[str]) -> None:
    with pytest.raises(BadTable) as error:
        read(tmp_path, "EPSG:25832\n" + lines + "\n")
    for part in ["list.txt", *says]:
        assert part in str(error.value)


@pytest.mark.parametrize(("text", "sigma"), [
    ("#Label,X/Easting,Y/Northing,Z/Altitude,X_Accuracy,Y_Accuracy,Z_Accuracy\nA,684210.5,5334100.25,412.1,0.01,0.02,0.03\n",
     (0.01, 0.02, 0.03)),
    ('"Station","N","E","Z","Std N","Std E","Std Z"\n"A","5334100.25","684210.5","412.1","0.02","0.01","0.03"\n',
     (0.01, 0.02, 0.03)),
    ("Nr;Rechtswert;Hochwert;Höhe;sxy;sz\nA;684.210,5;5.334.100,25;412,1;0,01;0,02\n", (0.01, 0.01, 0.02)),
    ('id,x,y,z,sxy,sz\nA,"684,210.5","5,334,100.25",412.1,0.01,0.02\n', (0.01, 0.01, 0.02)),
    ("NAME X Y Z sxy sz\nA 684210.5 5334100.25 412.1 0.01 0.02\n", (0.01, 0.01, 0.02)),
])
def test_headers_of_other_programs(tmp_path: Path, text: str, sigma: tuple[float, ...]) -> None:
    (tmp_path / "list.csv").write_text(text)
    control = read_control(tmp_path / "list.csv")
    assert control.names == ("A",) and control.xyz.tolist() == [[684210.5, 5334100.25, 412.1]]
    assert control.sigma.tolist() == [list(sigma)]
