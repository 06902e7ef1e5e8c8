"""The three tables: closed forms, bad meshes, and that nothing is NaN without a word."""

import csv
import io
from math import isfinite
from pathlib import Path

import numpy as np
import pytest
from benchmarks.double_bubble import DoubleBubble
from benchmarks.shapes import box, torus

from napari_deltamic.common.table import Column, table_of
from napari_deltamic.errors import InputError
from napari_deltamic.geometry import Mesh, sphere
from napari_deltamic.geometry.judgement import Judgement
from napari_deltamic.geometry.replicas import Replicas
from napari_deltamic.measure import Known, measure
from napari_deltamic.measure.cells import COLUMNS
from napari_deltamic.measure.channel_tables import CHANNEL_CELL_COLUMNS, CHANNEL_WALL_COLUMNS
from napari_deltamic.scene import Grid
from shapes import kelvin_cell

ROUND = Grid((12, 12, 12), (1.0, 1.0, 1.0), (-5.5, -5.5, -5.5))


def the_row(mesh, known=None):
    (row,) = measure(mesh, known).cells.rows
    return row


@pytest.fixture(scope="module")
def bubble():
    return DoubleBubble(3.0, (1.0, 0.9, 1.2), 0.1).mesh(0.5)


def check_no_silent_nan(measured):
    """Every empty cell of a number that the mesh alone could give has a note."""
    for table in measured.tables:
        for row in table.rows:
            assert set(row) == {c.name for c in table.columns}
            assert all(isfinite(v) for v in row.values() if isinstance(v, float))


def test_sphere():
    row = the_row(sphere((1, 2, 3), 2.0, subdivisions=5))
    assert row["volume_um3"] == pytest.approx(32 / 3 * np.pi, rel=1e-3)
    assert row["sphericity"] == pytest.approx(1, rel=1e-3)
    assert row["mean_curvature_per_um"] == pytest.approx(1 / 2, rel=1e-3)
    assert row["handles"] == 0
    assert [row[f"half_axis_{k}_um"] for k in (1, 2, 3)] == pytest.approx([2, 2, 2], rel=1e-3)
    assert row["note"] == "no pressure: it touches no other cell"
    assert row["cut_by_border"] is None


def test_ellipsoid_far_from_the_origin():
    row = the_row(sphere((1000, 2000, 3000), (1.0, 3.0, 2.0), edge_length=0.12))
    assert row["volume_um3"] == pytest.approx(8 * np.pi, rel=3e-3)
    assert [row[f"half_axis_{k}_um"] for k in (1, 2, 3)] == pytest.approx([3, 2, 1], rel=2e-3)
    assert [row[f"axis_1_{x}"] for x in "zyx"] == pytest.approx([0, 1, 0], abs=1e-3)
    assert [row[f"centroid_{x}_um"] for x in "zyx"] == pytest.approx([1000, 2000, 3000])


def test_torus_has_a_handle():
    row = the_row(torus((0, 0, 0), 5.0, 2.0))
    assert row["handles"] == 1
    assert row["area_um2"] == pytest.approx(4 * np.pi**2 * 10, rel=0.01)
    assert row["volume_um3"] == pytest.approx(2 * np.pi**2 * 20, rel=0.02)


@pytest.mark.parametrize(("other", "handles"), [("ball", 1), ("torus", 2)])
def test_handles_of_a_cell_in_two_parts(other, handles):
    """As in a file that names no cells."""
    more = {"ball": sphere((0, 0, 20), 2.0), "torus": torus((0, 0, 20), 5.0, 2.0)}[other]
    both = Mesh.merge([torus((0, 0, 0), 5.0, 2.0), more])
    row = the_row(Mesh(both.vertices, both.faces))
    assert row["handles"] == handles


def test_kelvin_cell():
    row = the_row(kelvin_cell(1.5))
    assert row["volume_um3"] == pytest.approx(8 * np.sqrt(2) * 1.5**3)
    assert row["area_um2"] == pytest.approx((6 + 12 * np.sqrt(3)) * 1.5**2)
    axes = [row[f"half_axis_{k}_um"] for k in (1, 2, 3)]
    assert axes == pytest.approx([axes[0]] * 3)


def test_double_bubble(bubble):
    exact = DoubleBubble(3.0, (1.0, 0.9, 1.2), 0.1)
    measured = measure(bubble)
    check_no_silent_nan(measured)
    assert measured.cells.values("volume_um3") == pytest.approx(list(exact.volumes), rel=0.02)
    assert measured.cells.values("neighbours") == ["2", "1"]
    assert measured.cells.values("note") == ["", ""]
    walls = measured.walls
    regions = list(zip(walls.values("region_a"), walls.values("region_b"), strict=True))
    assert regions == [(1, 0), (2, 0), (2, 1)]
    assert walls.values("area_um2") == pytest.approx(exact.areas.tolist(), rel=0.02)
    rim = 2 * np.pi * 3
    assert walls.values("junction_length_um") == pytest.approx([rim] * 3, rel=0.01)
    contact = walls.values("area_um2")[2]
    assert measured.cells.values("contact_area_um2") == pytest.approx([contact, contact])
    (row,) = measured.junctions.rows
    assert [row[f"region_{x}"] for x in "abc"] == [0, 1, 2]
    assert row["length_um"] == pytest.approx(rim, rel=0.01)
    assert row["measured_length_um"] == pytest.approx(row["length_um"])
    angles = [row[f"angle_{x}_deg"] for x in "abc"]
    assert angles == pytest.approx(exact.angles.tolist(), abs=0.6)


def test_existing_columns_come_first():
    assert tuple(c.name for c in measure(box((0, 0, 0), 1)).cells.columns)[:8] == COLUMNS


def test_an_open_surface():
    whole = sphere((0, 0, 0), 2.0)
    measured = measure(Mesh(whole.vertices, whole.faces[3:]))
    check_no_silent_nan(measured)
    (row,) = measured.cells.rows
    for name in ("volume_um3", "sphericity", "half_axis_1_um", "handles", "centroid_z_um"):
        assert row[name] is None, name
    assert row["area_um2"] > 40
    assert "no volume: its surface is open" in row["note"]
    assert "no curvature" in row["note"]


def test_a_surface_that_is_inside_out():
    whole = sphere((0, 0, 0), 2.0)
    row = the_row(Mesh(whole.vertices, whole.faces[:, ::-1]))
    assert row["volume_um3"] is None
    assert "inside out" in row["note"]


def test_a_cell_that_the_border_cuts():
    known = Known(grid=ROUND)
    assert the_row(sphere((0, 0, 0), 4.0), known)["cut_by_border"] == "no"
    row = the_row(sphere((0, 0, 3), 4.0), known)
    assert row["cut_by_border"] == "yes"
    assert row["note"].startswith("the border of the image cuts it; ")
    said = "dim; the border of the image cuts it: what lies beyond is a guess"
    known = Known(grid=ROUND, judgements={1: Judgement("fair", 0.1, said)})
    note = the_row(sphere((0, 0, 3), 4.0), known)["note"]
    assert note == f"{said}; no pressure: it touches no other cell", "the grade first, each once"
    assert row["volume_um3"] == pytest.approx(4 / 3 * np.pi * 64, rel=0.02)


def test_junctions_at_the_border_have_no_angles(bubble):
    near = Grid((12, 40, 40), (0.5, 0.5, 0.5), (-2.9, -10.0, -10.0))
    inside = measure(bubble).junctions.rows[0]
    cut = measure(bubble, Known(grid=near)).junctions.rows[0]
    assert 0 < cut["measured_length_um"] < inside["measured_length_um"]
    assert cut["length_um"] == inside["length_um"]


def test_a_wall_of_two_triangles():
    """Two boxes that share a side of two triangles."""
    v = box((0, 0, 0), 1).vertices_numpy()
    corner = {tuple(p): k for k, p in enumerate((v > 0).astype(int).tolist())}
    z, y = [0, 0, 1, 1], [0, 1, 1, 0]
    wall = [corner[(a, b, 1)] for a, b in zip(z, y, strict=True)]
    first = box((0, 0, 0), 1)
    second = first.translated((0, 0, 1))
    points = np.concatenate([v, second.vertices_numpy()])
    faces = np.concatenate([first.faces, second.faces + len(v)])
    regions = np.repeat([[1, 0], [2, 0]], [len(first.faces), len(second.faces)], axis=0)
    points, index = np.unique(points.round(9), axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    shared = np.isin(faces, index.reshape(-1)[wall]).all(1)
    # The side of the first box becomes the wall; that of the second goes.
    regions[shared & (regions[:, 0] == 1)] = [1, 2]
    kept = ~(shared & (regions[:, 0] == 2))
    measured = measure(Mesh(points, faces[kept], regions[kept]))
    check_no_silent_nan(measured)
    assert measured.cells.values("volume_um3") == pytest.approx([1, 1])
    row = measured.walls.rows[2]
    assert (row["region_a"], row["region_b"], row["n_faces"]) == (2, 1, 2)
    assert row["area_um2"] == pytest.approx(1)
    assert row["mean_curvature_per_um"] is None
    assert "no vertex lies inside the wall" in row["note"]
    assert row["tension"] is not None or "no tension" in row["note"]
    (junction,) = measured.junctions.rows
    assert junction["length_um"] == pytest.approx(4)


def test_a_wall_without_area():
    mesh = Mesh([[0, 0, 0], [0, 0, 1], [0, 0, 2]], [[0, 1, 2]])
    measured = measure(mesh)
    check_no_silent_nan(measured)
    assert "it has no area" in measured.walls.rows[0]["note"]


def test_densities_are_relative_to_the_mean_membrane(bubble):
    shared = (bubble.regions != 0).all(1)
    measured = measure(bubble, Known(density=np.where(shared, 6.0, 3.0)))
    outer, _, inner = measured.walls.values("density")
    assert inner == pytest.approx(2 * outer)
    total = [(1, outer), (2, inner)]
    areas = [bubble.areas()[~shared].sum(), bubble.areas()[shared].sum()]
    mean = sum(n * d * a for (n, d), a in zip(total, areas, strict=True))
    assert mean / (areas[0] + 2 * areas[1]) == pytest.approx(1)


def test_densities_of_another_mesh_are_refused(bubble):
    with pytest.raises(InputError, match="5 densities"):
        measure(bubble, Known(density=np.ones(5)))
    with pytest.raises(InputError, match="finite"):
        measure(bubble, Known(density=np.full(len(bubble.faces), np.nan)))


def replicas(mesh, **changed):
    """Of a fit that is exact, but for what is given."""
    v = mesh.vertices_numpy()
    given = {"settled": v, "smooth": mesh, "refitted": v, "pulled": v, "finer": 16}
    return Replicas(mesh, **{**given, "scatter": np.zeros((1, *v.shape)), **changed})


def test_errors_are_the_scatter_of_replicas():
    """A sphere whose radius is unsure by 0.1: volume and area follow, it stays a sphere."""
    mesh = sphere((0, 0, 0), 3.0, subdivisions=3)
    outwards = 0.1 * mesh.vertices_numpy() / 3.0
    known = Known(replicas=replicas(mesh, scatter=outwards[None]))
    plain, row = the_row(mesh), the_row(mesh, known)
    assert row["volume_se_um3"] == pytest.approx(plain["volume_um3"] * 0.1, rel=2e-3)
    assert row["area_se_um2"] == pytest.approx(2 * plain["area_um2"] / 3.0 * 0.1, rel=2e-3)
    assert row["sphericity_se"] == pytest.approx(0, abs=1e-9)
    mean = plain["mean_curvature_per_um"]
    assert row["mean_curvature_se_per_um"] == pytest.approx(mean / 3.0 * 0.1, rel=2e-3)
    wall = measure(mesh, known).walls.rows[0]
    assert wall["area_se_um2"] == pytest.approx(row["area_se_um2"])
    # (r + d)^2 and (r - d)^2 are d^2 more than r^2 in the mean.
    assert row["area_bias_um2"] == pytest.approx(plain["area_um2"] * (0.1 / 3.0) ** 2, rel=1e-6)


def test_numbers_are_corrected_by_what_flat_triangles_and_the_prior_are_off_by():
    mesh, fine = (sphere((0, 0, 0), 3.0, subdivisions=n) for n in (2, 4))
    v = mesh.vertices_numpy()
    exact = 4 / 3 * np.pi * 27
    row = the_row(mesh, Known(replicas=replicas(mesh, smooth=fine)))
    assert abs(the_row(mesh)["volume_um3"] / exact - 1) > 0.03
    assert row["volume_um3"] == pytest.approx(exact, rel=2e-3)
    assert row["area_um2"] == pytest.approx(4 * np.pi * 9, rel=2e-3)
    # The prior has shrunk it; with more patience it would have grown, which is no mean error.
    plain = the_row(mesh)["volume_um3"]
    row = the_row(mesh, Known(replicas=replicas(mesh, pulled=0.99 * v, settled=1.02 * v)))
    assert row["volume_bias_um3"] == pytest.approx((0.99**3 - 1) * plain)
    assert row["volume_se_um3"] == pytest.approx((1.02**3 - 1) * plain, rel=1e-2)


def test_what_cannot_be_measured_on_replicas_has_no_error(bubble):
    """Draws that tear a cell open, or turn it inside out, say nothing of its volume."""
    v = bubble.vertices_numpy()
    measured = measure(bubble, Known(replicas=replicas(bubble, scatter=-2 * v[None])))
    check_no_silent_nan(measured)
    row, plain = measured.cells.rows[0], measure(bubble).cells.rows[0]
    assert row["volume_se_um3"] is None
    assert row["volume_um3"] == plain["volume_um3"]


def test_what_a_fit_explains_and_doubts_is_passed_on():
    row = the_row(
        sphere((0, 0, 0), 2.0),
        Known(explained={1: 0.9}, judgements={1: Judgement("poor", 0.2, "shrank away")}),
    )
    assert row["explained"] == 0.9
    assert "shrank away" in row["note"]


def test_the_same_mesh_gives_the_same_text_and_the_text_reads_back(bubble):
    one, other = measure(bubble), measure(bubble)
    for table, again in zip(one.tables, other.tables, strict=True):
        text = table.to_csv()
        assert text == again.to_csv()
        rows = list(csv.DictReader(io.StringIO(text)))
        assert len(rows) == len(table.rows)
        for read, row in zip(rows, table.rows, strict=True):
            for name, value in row.items():
                if value is None:
                    assert read[name] == ""
                elif isinstance(value, float):
                    assert float(read[name]) == pytest.approx(value, rel=1e-8)
                else:
                    assert read[name] == str(value)


def test_units_are_at_the_end_of_names():
    ends = {"um": "_um", "um^2": "_um2", "um^3": "_um3", "1/um": "_per_um", "1/um^2": "_per_um2",
            "degrees": "_deg", "": ""}  # fmt: skip
    for table in measure(box((0, 0, 0), 1)).tables:
        for column in table.columns:
            assert column.name.endswith(ends[column.unit]), column.name


def test_numbers_that_are_none_become_empty():
    table = table_of("t", [Column("a", ""), Column("b", "")], [{"a": float("inf")}])
    assert table.rows == ({"a": None, "b": None},)
    assert table.to_csv() == "a,b\n,\n"


def test_the_docs_say_what_every_column_is():
    page = Path(__file__).parents[2] / "docs" / "measurements.md"
    if not page.exists():
        pytest.skip("not in a source tree")
    lines = page.read_text(encoding="utf-8").splitlines()
    told = [line for line in lines if line.startswith("| `") and line.count("|") == 4]
    tables = [table.columns for table in measure(box((0, 0, 0), 1)).tables]
    wanted = [
        f"| `{c.name}` | {c.unit} | {c.meaning} |"
        for columns in (*tables, CHANNEL_WALL_COLUMNS, CHANNEL_CELL_COLUMNS)
        for c in columns
    ]
    assert told == wanted


@pytest.mark.parametrize("kind", ["soup", "holes", "noise", "flat", "windings"])
def test_whatever_the_mesh_there_is_a_number_or_nothing(bubble, kind):
    """No exception, no NaN, no warning (which would be an error here)."""
    rng = np.random.default_rng(0)
    v, faces, regions = bubble.vertices_numpy(), bubble.faces, bubble.regions
    for _ in range(8):
        if kind == "soup":
            n = int(rng.integers(3, 12))
            corners = rng.normal(0, 1, (n, 3)) * 10.0 ** rng.integers(-6, 6)
            some = [rng.choice(n, 3, replace=False) for _ in range(rng.integers(1, 20))]
            mesh = Mesh(corners, some, [rng.choice(5, 2, replace=False) for _ in some])
        elif kind == "holes":
            kept = rng.random(len(faces)) < rng.uniform(0.2, 1)
            mesh = Mesh(v, faces[kept], regions[kept])
        elif kind == "noise":
            mesh = bubble.with_vertices(v + rng.normal(0, rng.choice([0.05, 0.5, 3]), v.shape))
        elif kind == "flat":
            squeezed = v.copy()
            squeezed[:, rng.integers(3)] *= rng.choice([0, 1e-9])
            mesh = bubble.with_vertices(squeezed)
        else:
            turned = rng.random(len(faces)) < 0.3
            mesh = Mesh(v, faces, np.where(turned[:, None], regions[:, ::-1], regions))
        density = rng.random(len(mesh.faces))
        check_no_silent_nan(measure(mesh, Known(grid=ROUND, density=density, resolution=0.3)))


def test_a_rounded_rim_makes_angles_unsure(bubble):
    """Arcs of different reach then read different angles."""

    def outer_angle(mesh):
        (row,) = measure(mesh, Known(replicas=replicas(mesh))).junctions.rows
        return row["angle_a_deg"], row["angle_a_se_deg"]

    ends = bubble.edges()
    v = bubble.vertices_numpy().copy()
    for _ in range(3):  # each vertex goes halfway to the middle of its neighbours
        total, count = np.zeros_like(v), np.zeros(len(v))
        for one, other in (ends.T, ends.T[::-1]):
            np.add.at(total, one, v[other])
            np.add.at(count, one, 1)
        v = (v + total / count[:, None]) / 2
    sharp, sure = outer_angle(bubble)
    rounded, unsure = outer_angle(bubble.with_vertices(v))
    assert sure < 0.6
    assert rounded - sharp > 2.0
    assert unsure > 0.5 * (rounded - sharp)
