"""Reports: no peak lost, numbers as they are, pages that work with whatever a run holds."""

import csv
import io
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from browser import Browser, require
from contrast import faint_texts, prefer
from legible import faults
from synthetic import DRAG, PERIOD_S, SyntheticRun, slope_run

from cosim.comparisons.sweep import Sweep
from cosim.errors import InputError
from cosim.units import measured, quantity, scale
from reports import Trial, compare_table, write_report
from reports.decimate import keep_peaks, merge_spans
from reports.effects import draw as draw_effects
from reports.energy_and_cost import energy
from reports.formatting import ratio, share
from reports.notebook import figure, html
from reports.page import FIGURES, draw_all, glue, render
from reports.study_page import Section, TextTable
from reports.style import figure as figure_of_axes
from reports.style import look
from reports.summary import summary, tiles
from reports.sweep import draw as draw_sweep
from reports.tables import all_tables, command_line
from reports.view import View


@pytest.fixture(scope="module")
def run() -> SyntheticRun:
    return slope_run()


@pytest.fixture(scope="module")
def page(run: SyntheticRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    other = slope_run(stiffness=133.0)
    trials = [Trial("nominal", run.measures, run), Trial("R12=8.2k", other.measures, other)]
    return write_report(run, tmp_path_factory.mktemp("report"), trials)


def drop_run() -> SyntheticRun:
    """A slider that falls straight onto a floor: one joint, nothing along the wall."""
    time = np.linspace(0.0, 2.0, 4001)
    height = 0.01 * np.cos(8 * time) * np.exp(-time)
    zero = np.zeros_like(time)
    signals = {"time": time, "q1": height / 0.013, "v1": zero, "x": zero, "y": height, "fx": zero}
    signals |= {"fy": -np.maximum(-100 * height, 0), "imot1": np.maximum(-height, 0) * 30}
    ticks = np.arange(0.0, 2.0, PERIOD_S)
    pen = -np.interp(ticks, time, height)
    scene = {
        "device": {"linkage": "slider", "slider": {"radius_m": 0.013, "direction": [0.0, 1.0]}},
        "wall": {"point_m": [0.0, 0.0], "normal": [0.0, 1.0]},
        "computer": {"period_s": PERIOD_S, "method": "continuous", "analog_stiffness_n_per_m": 100.0},
    }
    samples = {"time": ticks, "contact": (pen > 0).astype(float), "pen": pen, "ksp11": np.ones_like(ticks)}
    return SyntheticRun(
        scene=scene, signals=signals, samples=samples, plan={"constants": {"kt": 0.035, "gear": 8.0}}
    )


# --- thinning


def test_thinning_keeps_peaks_and_only_real_points() -> None:
    rng = np.random.default_rng(3)
    time = np.sort(rng.random(200_000))
    value = rng.standard_normal(time.size)
    value[123_456] = 1e3  # one point wide
    kept_time, kept = keep_peaks(time, value, 300)
    assert kept.size <= 4 * 300
    assert (kept.max(), kept.min()) == (value.max(), value.min())
    assert (kept_time[0], kept_time[-1]) == (time[0], time[-1])
    assert np.all(np.diff(kept_time) >= 0)
    assert np.array_equal(value[np.searchsorted(time, kept_time)], kept)


def test_thinning_keeps_the_extremes_of_every_column() -> None:
    time = np.linspace(0.0, 1.0, 100_001)
    value = np.sin(2e4 * time)  # many periods in each column
    kept_time, kept = keep_peaks(time, value, 50)
    column = np.minimum((time * 50).astype(int), 49)
    kept_column = np.minimum((kept_time * 50).astype(int), 49)
    for number in range(50):
        assert kept[kept_column == number].max() == value[column == number].max()


def test_short_or_standing_signals_are_left_alone() -> None:
    time = np.zeros(10_000)  # all at one instant: no columns to speak of
    assert keep_peaks(time, time)[0].size == time.size
    short = np.arange(5.0)
    assert keep_peaks(short, short)[1] is short


def test_spans_closer_than_a_pixel_are_joined() -> None:
    assert merge_spans([(0.0, 1.0), (1.05, 2.0), (3.0, 4.0)], 0.1) == [(0.0, 2.0), (3.0, 4.0)]


# --- words


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.00429, "m", "4.29 mm"), (0.876, "N", "0.876 N"), (0.00999999, "m", "10 mm"),
        (4.2e-7, "rad", "420 nrad"),
        (3600.0, "s", "3600 s"), (233.0, "N/m", "233 N/m"), (0.0, "J", "0 J"), (-0.02, "V", "-20 mV"),
        (1e-20, "J", "1.00e-08 pJ"), (0.25, "", "0.250"), (float("nan"), "m", "not known"),
        (2.5, "A^2 s", "2.50 A² s"), (0.0, "m/s^2", "0 m/s²"),
    ],
)  # fmt: skip
def test_quantities_read_well(value: float, unit: str, text: str) -> None:
    assert quantity(value, unit) == text


def test_shares_and_axes_read_well() -> None:
    assert (share(0.353), share(0.0123), share(1e-7), ratio(2.01e-8)) == (
        "35 %",
        "1.2 %",
        "below 0.1 %",
        "2.0e-8",
    )
    assert scale(0.03, "J") == (1e3, "mJ")
    assert scale(0.5, "N") == (1.0, "N")
    assert scale(0.0, "V") == (1.0, "V")


def test_a_page_writes_units_one_way(tmp_path: Path) -> None:
    # squares and micros of files, where they stand in headings, in cells and in sentences
    assert measured(2.0, 0.1, "A^2 s") == "2.0 ± 0.1 A² s"
    table = TextTable("t", ["delay [us]", "a [m/s^2]"], [["2 us", "3 A^2 s"]], set(), "within 5 us")
    html = render("study.html.j2", title="", command="", summary=["9.81 m/s^2"], sections=[
        Section("s", "s", [], ("2 uJ of 2^24 codes",), [], [table], "")], claims=[], warnings=[])  # fmt: skip
    text = html.replace("\u00a0", " ")
    for right in (
        "delay [µs]",
        "a [m/s²]",
        "2 µs<",
        "3 A² s",
        "within 5 µs",
        "9.81 m/s²",
        "2 µJ of 2^24 codes",
    ):
        assert right in text


def test_a_command_is_the_one_to_be_typed() -> None:
    at = "/usr/lib/python3/site-packages/cosim/__main__.py"
    assert command_line([at, "run", "a b.toml"]) == "cosim run 'a b.toml'"
    assert command_line(["/usr/bin/cosim", "run"]) == "cosim run"
    assert command_line(["/home/me/other/__main__.py", "x"]) == "__main__.py x"


def test_no_line_ends_between_number_and_unit() -> None:
    assert glue("3 s at 233 N/m (+4.5 %), 12 points") == "3\u00a0s at 233\u00a0N/m (+4.5\u00a0%), 12 points"


def test_summary_states_the_numbers_of_the_run(run: SyntheticRun) -> None:
    words = " ".join(summary(View(run)))
    depth = quantity(float(-View(run).place[1].min()), "m")  # type: ignore[index]
    for part in (
        "3 s were simulated with 2 joints", "every 25 ms", f"at most {depth}", "228.3 N/m where 233 N/m",
        "xboard.xdrv1.xop (opa548) would clip first", "10.2 V of its 11.3 V", "1.10 V are left",
        "energy ledger closes to", f"{run.stats['points']} points and 1.90 s", "420 nrad",
    ):  # fmt: skip
        assert part in words


def test_summary_states_means_over_time_not_over_points(run: SyntheticRun) -> None:
    # The same run with its points crowded into the weak first half must have the same mean force.
    time = run.signals["time"]
    crowd = np.union1d(time, np.linspace(0.6, 0.7, 20_000))
    dense = {name: np.interp(crowd, time, value) for name, value in run.signals.items()}
    first, second = (
        re.search(r"feels ([\d.]+) N", " ".join(summary(View(each))))
        for each in (run, replace(run, signals=dense))
    )
    assert first is not None
    assert second is not None
    assert first[1] == second[1]


def test_drag_of_separate_joints_is_stated() -> None:
    assert any(tile.value == share(DRAG) for tile in tiles(View(slope_run(drag=True))))


def test_summary_says_what_did_not_happen() -> None:
    untouched = slope_run()
    untouched.samples = {**untouched.samples, "contact": 0 * untouched.samples["contact"]}
    assert "The wall was not touched." in summary(View(untouched))
    assert "There is no wall in this scene." in summary(View(replace(untouched, scene={})))


# --- figures


def test_page_has_every_figure_as_png_svg_and_data(page: Path) -> None:
    names = {"compare", *(name for name, *_ in FIGURES)}
    assert {path.name for path in (page.parent / "figures").iterdir()} == {
        f"{name}.{kind}" for name in names for kind in ("png", "svg", "csv")
    }
    html = page.read_text(encoding="utf-8")
    for name in names:
        assert f'<figure id="{name}">' in html


def test_page_is_self_contained(page: Path) -> None:
    html = page.read_text(encoding="utf-8")
    targets = re.findall(r'(?:src|href)="([^"]*)"', html)
    assert all(target.startswith(("data:", "#", "figures/")) for target in targets)
    assert "<script" not in html
    assert "http" not in re.sub(r'"data:[^"]*"', "", html)
    # Every address within the page has its place, every file beside it is there.
    assert all(f'id="{target[1:]}"' in html for target in targets if target.startswith("#"))
    assert all((page.parent / target).is_file() for target in targets if target.startswith("figures/"))


def test_data_of_a_figure_holds_what_it_shows(run: SyntheticRun, page: Path) -> None:
    rows = list(csv.DictReader(io.StringIO((page.parent / "figures/currents.csv").read_text())))
    for motor in (1, 2):
        drawn = [float(row["y"]) for row in rows if row["series"] == f"motor {motor}"]
        assert max(drawn) == pytest.approx(
            run.signals[f"imot{motor}"].max(), rel=1e-8
        )  # nine digits are written
    assert {row["x_axis"] for row in rows} == {"time [s]"}
    bars = list(csv.DictReader(io.StringIO((page.parent / "figures/headroom.csv").read_text())))
    assert {"xboard.xdrv1.xop  opa548"} <= {row["series"] for row in bars if row["x"] == "10.2"}


def test_motor_force_inverts_the_jacobian(run: SyntheticRun) -> None:
    view = View(run)
    part = view.time > 1.0
    latest = np.maximum(np.searchsorted(view.sample_time, view.time[part], side="left") - 1, 0)
    assert view.place is not None
    expected = 100.0 * -view.place[1][part] + 133.0 * view.sampled("pen")[latest]
    pressed = -view.place[1][part] > 1e-4
    assert view.motor_force(part)[pressed] == pytest.approx(expected[pressed], rel=1e-4)  # type: ignore[index]


def test_contact_is_the_computers(run: SyntheticRun) -> None:
    (span,) = View(run).contact_spans
    # The force starts at 0.6 s and ends at 2.7 s; the computer sees either at its next sample.
    assert span[0] == pytest.approx(0.6, abs=PERIOD_S + 1e-9)
    assert span[1] == pytest.approx(2.7, abs=PERIOD_S + 1e-9)


def test_energy_that_parting_flanks_lose_is_stated(run: SyntheticRun) -> None:
    """The points' powers do not hold it: the run's ledger does, and the caption tells the difference."""
    time = np.asarray(run.signals["time"])
    signals = {**run.signals, "p_shaft": np.full_like(time, -1e-3), "e_shaft": np.zeros_like(time)}
    smooth = -1e-3 * (time[-1] - time[0])
    for lost, stated in ((0.25, True), (0.0, False)):
        ledger = {**run.ledger, "work_j": {"shafts": smooth - lost}}
        drawn = energy(View(replace(run, signals=signals, ledger=ledger)))
        assert drawn is not None
        assert ("250 mJ that flanks of a gear lose as they part" in drawn.caption) is stated, drawn.caption


def test_many_joints_say_what_is_not_drawn(run: SyntheticRun) -> None:
    signals = {**run.signals, **{f"q{j}": run.signals["q1"] for j in range(3, 7)}}
    pairs = {f"ksp{i}{j}": run.samples["ksp11"] * (i + j) for i in range(1, 7) for j in range(1, 7)}
    pictures, absent = draw_all(View(replace(run, signals=signals, samples={**run.samples, **pairs})))
    gains = next(picture for picture in pictures if picture.name == "gains")
    assert "6 largest of 36" in gains.caption
    assert "VCA gains" not in absent


def test_straight_motion_shows_no_tangent() -> None:
    pictures, _ = draw_all(View(drop_run()))
    captions = {picture.name: picture.caption for picture in pictures}
    assert "nothing moves" in captions["tangent_normal"]
    assert "speed over position" in captions["path"]
    assert not any("drag" in tile.label for tile in tiles(View(drop_run())))


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "change",
    [
        {"signals": {}, "samples": {}, "scene": {}, "plan": {}, "stats": {}, "ledger": {}, "measures": {}},
        {"signals": {"time": np.zeros(1)}},
        {"samples": {}},
        {"scene": {}},
        {"signals": {"time": np.linspace(0, 1, 5), "imot1": np.zeros(5)}, "samples": {}},
    ],
    ids=["nothing", "one point", "no samples", "no scene", "one signal"],
)
def test_page_of_a_run_with_parts_missing(run: SyntheticRun, tmp_path: Path, change: dict[str, Any]) -> None:
    html = write_report(replace(run, **change), tmp_path).read_text(encoding="utf-8")
    assert "Not drawn" in html
    assert "nan" not in re.sub(r'"data:[^"]*"', "", html).lower().split()


def test_long_run_stays_a_small_page(tmp_path: Path) -> None:
    page = write_report(slope_run(duration_s=100.0), tmp_path)  # 212 000 points, 4000 samples
    assert page.stat().st_size < 3_000_000


def test_same_run_gives_the_same_bytes(run: SyntheticRun, page: Path) -> None:
    fresh, _ = draw_all(View(run))
    for picture in fresh:
        assert (page.parent / "figures" / f"{picture.name}.svg").read_bytes() == picture.svg


def test_users_matplotlibrc_is_neither_used_nor_changed(run: SyntheticRun, page: Path) -> None:
    import matplotlib as mpl

    with mpl.rc_context({"font.size": 30.0}):
        fresh, _ = draw_all(View(replace(run, samples={})))
        assert mpl.rcParams["font.size"] == 30.0
    currents = next(picture for picture in fresh if picture.name == "currents")
    assert len(currents.svg) == pytest.approx((page.parent / "figures/currents.svg").stat().st_size, rel=0.3)


# --- tables and files


def test_comparison_shows_value_and_relative_change() -> None:
    def measures(stiffness: float, depth: float) -> dict[str, dict[str, Any]]:
        return {
            "rendered_stiffness": {"value": stiffness, "unit": "N/m", "text": ""},
            "depth": {"value": depth, "unit": "m", "text": ""},
        }

    table = compare_table(
        [Trial("10k", measures(200.0, 0.005)), Trial("8.2k", measures(220.0, 0.005)), Trial("none", {})]
    )
    assert table.head == ("measure", "10k", "8.2k", "none")
    assert table.rows == (
        ("rendered stiffness", "200 N/m", "220 N/m (+10 %)", "-"),
        ("depth", "5 mm", "5 mm (same)", "-"),
    )
    assert compare_table([]).rows == ()


def test_tables_split_units_from_names(run: SyntheticRun) -> None:
    tables = {table.name: dict(row[:2] for row in table.rows) for table in all_tables(View(run))}
    assert tables["statistics"]["wall"] == "1.900 s"
    assert tables["ledger"]["work: p mot"].endswith("J")
    assert tables["provenance"]["command"] == "cosim run slope.toml"
    assert tables["effects"] == {"opamp": "full", "gravity": "no"}


def test_texts_of_the_user_are_escaped(tmp_path: Path) -> None:
    html = write_report(SyntheticRun(scene={"title": "<b>R & D</b>"}), tmp_path).read_text(encoding="utf-8")
    assert "<h1>&lt;b&gt;R &amp; D&lt;/b&gt;</h1>" in html


def test_report_is_replaced_whole(tmp_path: Path) -> None:
    write_report(drop_run(), tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    write_report(SyntheticRun(), tmp_path)
    assert list((tmp_path / "figures").iterdir()) == []
    kept = {".cosim-files.json", "figures", "notes.txt", "report.html"}
    assert {path.name for path in tmp_path.iterdir()} == kept


def test_unwritable_place_is_the_users_mistake(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written") as caught:
        write_report(SyntheticRun(), tmp_path / "file" / "report")
    assert caught.value.exit_code == 2
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_import_is_light() -> None:
    code = "import sys, reports; print(sorted({'matplotlib', 'jinja2', 'scipy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# --- browser


@pytest.mark.browser
def test_page_in_a_browser(page: Path, tmp_path: Path) -> None:
    require()
    with Browser() as browser:
        visit = browser.visit(page)
        assert visit.complaints == []
        assert visit.requests == [page.resolve().as_uri()]
        images = browser.evaluate(
            "[...document.images].map(i => [i.complete, i.naturalWidth, i.clientWidth, i.clientHeight])"
        )
        assert len(images) == len(FIGURES) + 1
        assert all(
            done and natural > 0 and width > 600 and high > 100 for done, natural, width, high in images
        )
        # Neither a laptop nor a narrow window needs scrolling sideways.
        for width in (1280, 700):
            browser.resize(width, 800)
            assert browser.evaluate("document.documentElement.scrollWidth") <= width
        browser.screenshot(tmp_path / "page.png")
        browser.pdf(tmp_path / "page.pdf")
    assert (tmp_path / "page.png").stat().st_size > 100_000  # a blank page of this size takes 20 kB
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.browser
def test_a_telephone_shows_figures_that_can_be_read(page: Path) -> None:
    """At 420 px the text of figures is at least 9 px high; they and tables scroll, the page does not."""
    require()
    with Browser() as browser:
        assert browser.visit(page).complaints == []
        browser.resize(420, 800)  # a window of its own is never so narrow
        assert browser.evaluate("document.documentElement.scrollWidth") <= 420
        widths = browser.evaluate("[...document.images].map(i => i.clientWidth)")
        # 9 point, the smallest of a figure that is 9.2 inches wide
        assert all(width / 9.2 * 9.0 / 72.0 > 9.0 for width in widths)
        held = browser.evaluate(
            "[...document.querySelectorAll('figure img, table')].map(e => {const s = e.closest('.scroll');"
            " return s !== null && getComputedStyle(s).overflowX === 'auto' && s.clientWidth <= 420})"
        )
        assert held
        assert all(held)


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_stand_out(page: Path, scheme: str) -> None:
    require()
    with Browser() as browser:
        prefer(browser, scheme)
        browser.visit(page)
        seen, faint = faint_texts(browser)
        assert seen > 100
        assert faint == {}


def test_figures_can_be_read(run: SyntheticRun) -> None:
    """No label on another, no axis without a name, nothing cut off: of every figure, and of the effects."""
    drawn = [figure(run, name) for name, *_ in FIGURES if name != "nodes"]
    with look():
        for each in drawn:
            assert faults(each) == []


def test_a_notebook_shows_bounds_and_units(run: SyntheticRun) -> None:
    """As the page does, at most six digits: the bound is rounded up."""
    row = {"value": 104.474, "unit": "N/m", "error": 0.0008, "text": "steady force over depth"}
    shown = html(replace(run, measures={"rendered_stiffness": row}))
    assert "<td>104.474 ± 0.001 N/m</td>" in shown
    assert re.search(r'<img alt="[^"]{12,}"', shown)
    assert re.search(r"<figcaption>[^<]{40,}</figcaption>", shown)


def test_what_cannot_be_read_is_seen() -> None:
    with look():
        drawing, axes = figure_of_axes(2.0, columns=2)
        axes[0, 0].set_title("a title that is far too long for its half of the figure, and more")
        axes[0, 1].set_title("another one")
        axes[0, 1].set_xlabel("time [s]")
        axes[0, 1].set_xticks([0.0, 0.001], ["0.000", "0.001"])
        axes[0, 1].set_xlim(0.0, 0.02)
        axes[0, 1].set_ylabel("$k^2$ [N/m]").set_parse_math(False)
        words = " ".join(faults(drawing))
    assert "lies on 'another one'" in words
    assert "ticks 0.000 and 0.001 of x overlap" in words
    assert "a formula is drawn as it is written: $k^2$ [N/m]" in words


def test_every_figure_of_the_page_has_words(page: Path) -> None:
    """An alternative text, and a caption of a sentence or more."""
    text = page.read_text(encoding="utf-8")
    figures = re.findall(r"<figure.*?</figure>", text, re.DOTALL)
    assert len(figures) == len(FIGURES) + 1
    for each in figures:
        assert len(re.search(r'alt="([^"]+)"', each)[1]) > 40  # type: ignore[index]
        assert len(re.search(r"<figcaption>(.*?)<span", each, re.DOTALL)[1].strip()) > 40  # type: ignore[index]


def test_the_effects_picture_says_what_it_is(tmp_path: Path) -> None:
    row = {"effect": "dac", "value": "True", "on": {"peak_force": 0.01}, "off": {"peak_force": 0.02}}
    ledger = SimpleNamespace(
        rows=[SimpleNamespace(**row, on_s=0.01, off_s=0.02)],
        full={"peak_force": {"value": 2.0, "unit": "N"}},
    )
    with look():
        drawing = draw_effects(ledger, "peak_force", "Static push")  # type: ignore[arg-type]
    assert drawing.get_suptitle() == "Static push: what each effect does to peak force"
    assert "1 % of its value with all effects, 2 N" in drawing.get_supxlabel().replace("\n", " ")


def test_a_sweep_says_what_it_is_over() -> None:
    for name, label in (
        ("computer.period_s", "computer.period_s [s]"),
        ("R12", "R12 [Ohm]"),
        ("xdiff1.r_diff_fb", "xdiff1.r_diff_fb [Ohm]"),
        ("c_der_in", "c_der_in [F]"),
        ("computer.gain_ramp_samples", "computer.gain_ramp_samples"),
        ("rho", "rho"),
    ):
        result = Sweep((name,), (("1",), ("2",)), {"peak_force": (1.0, 2.0)}, {})
        with look():
            drawn = draw_sweep(result)
        assert drawn is not None
        assert drawn.figure.axes[-1].get_xlabel() == label
        assert drawn.figure.axes[0].get_ylabel() == "peak force [N]"
        assert drawn.figure.get_suptitle() == f"peak force over {name}"
