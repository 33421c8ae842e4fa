"""Columns of text: headings, times, separators, decimal commas, several channels."""

import numpy as np
import pytest

import rockjax as rj

G = 9.80665
WAVE = np.sin(np.arange(401) / 20 * np.pi)  # ten periods


def table(tmp_path, heading, *columns, separator=",", decimal=".", name="a.csv"):
    """Write a file of columns; the columns contain texts, or numbers that are written with eight digits."""
    words = [[y if isinstance(y, str) else f"{y:.8g}" for y in column] for column in columns]
    rows = [separator.join(row).replace(".", decimal) for row in zip(*words, strict=True)]
    path = tmp_path / name
    path.write_text("\n".join([*([] if heading is None else [heading]), *rows, ""]), encoding="utf-8")
    return path


STEPS = np.arange(401)


@pytest.mark.parametrize(
    ("heading", "separator", "factor", "step", "dt"),
    [
        ("time [ms],acc [m/s2]", ",", 1.0, 5, 0.005),
        ("Time (ms),Acc (m/s2)", ",", 1.0, 5, 0.005),
        ("TIME / MS;ACC, MG", ";", 1e-3 * G, 5, 0.005),
        ("time_ms\taccel_g", "\t", G, 10, 0.01),
        ("Time, us, Acc, g", ",", G, 5000, 0.005),
        ("t (min)  a (cm/s/s)", "  ", 0.01, 0.01, 0.6),
        ("Zeit [s];Beschl. [Gal]", ";", 0.01, 0.02, 0.02),
        ("time,acc\n[ms],[g]", ",", G, 5, 0.005),
        ("time acc\ns g", " ", G, 0.01, 0.01),
        ("# time [ms],acc [g]", ",", G, 5, 0.005),  # as written by numpy.savetxt
    ],
)
@pytest.mark.filterwarnings("ignore::rockjax.RecordWarning")
def test_units_of_both_columns(tmp_path, heading, separator, factor, step, dt):
    motion = rj.read_motion(table(tmp_path, heading, step * STEPS, WAVE, separator=separator))
    assert motion.dt == pytest.approx(dt, rel=1e-12)
    np.testing.assert_allclose(motion.acceleration, factor * WAVE, atol=1e-7 * factor)


@pytest.mark.parametrize(
    ("heading", "words"),
    [
        (
            "time [s],Acc (cm/s2)",
            [":1: the heading 'Acc (cm/s2)' gives the unit as cm/s2", "units = g was given"],
        ),
        ("time (s),Acc (gal) corrected", ["'Acc (gal) corrected' gives the unit as gal", "units = g"]),
        ("time (s),Acc, m/s/s", ["'Acc, m/s/s' gives the unit as m/s2", "units = g"]),
        ("time (s);Acc, m/s/s", ["'Acc, m/s/s' gives the unit as m/s2", "units = g"]),
        ("time_s,acc_m_s2", ["'acc_m_s2' gives the unit as m/s2", "units = g"]),
        ("time_s acc_cmps2", ["'acc_cmps2' gives the unit as cm/s2", "units = g"]),
        ("t/s;a/gal", ["'a/gal' gives the unit as gal", "units = g"]),
        ("time [s],acc [furlongs]", ["unit 'furlongs' in the heading 'acc [furlongs]' is not known"]),
        ("time [s],acc [counts]", ["'acc [counts]' gives raw counts"]),
        ("time [s],acc [cm/s]", ["'acc [cm/s]': cm/s is not a unit of acceleration"]),
        ("time [s],vel [cm/s]", ["none of the headings names an acceleration", "'vel [cm/s]'"]),
        ("Time (UTC),acc [g]", ["unit 'UTC' in the heading 'Time (UTC)'"]),
        ("abscissa,acc [g]", ["'abscissa' is unknown", "name it time [s]"]),
        ("El Centro 1940 record", ["does not name 2 columns", "begin comments with #"]),
        (",acc [g]", ["has no column of times", "a column without name", "give dt"]),
        ("Unnamed: 0,acc [g]", ["has no column of times", "give dt"]),
        ("index,acc [g]", ["has no column of times", "give dt"]),
    ],
)
def test_headings_that_contradict_or_are_not_understood(tmp_path, heading, words):
    separator = ";" if ";" in heading else ","
    path = table(tmp_path, heading, STEPS, WAVE, separator=separator)
    with pytest.raises(ValueError) as error:
        rj.read_motion(path, units="g")
    assert str(error.value).startswith(f"{path}:1: ")
    assert all(word in str(error.value) for word in words), error.value


def test_a_column_that_counts_is_no_time(tmp_path):
    for first, heading in ((0, None), (1, None), (0, ",acc"), (0, "sample,acc"), (0, ",0")):
        path = table(tmp_path, heading, STEPS + first, WAVE)
        with pytest.raises(ValueError, match=r"has no column of times .*; give dt"):
            rj.read_motion(path, units="m/s2")
        assert rj.read_motion(path, units="m/s2", dt=0.01).dt == 0.01
    both = table(tmp_path, "Unnamed: 0,time [s],acc [g]", STEPS, 0.005 * STEPS, WAVE)
    assert rj.read_motion(both).dt == pytest.approx(0.005, rel=1e-12)


@pytest.mark.parametrize("dt", [5.0, 1.0, 0.25, 5e-5])
def test_intervals_that_no_accelerograph_has_are_doubted(tmp_path, dt):
    path = table(tmp_path, "time,acc [g]", dt * STEPS, WAVE)
    with pytest.warns(rj.RecordWarning, match=rf"a\.csv: the sampling interval is {dt:g} s, .* in seconds\?"):
        rj.read_motion(path)
    with pytest.warns(rj.RecordWarning, match="sampling interval is 2 s"):
        rj.Record.from_file(table(tmp_path, None, WAVE), units="g", dt=2.0)


@pytest.mark.parametrize(
    ("dt", "form"),
    [
        (1 / 128, "{:.4f}"),
        (1 / 128, "{:.6g}"),
        (1 / 300, "{:.4f}"),
        (0.005, "{:.2f}"),
        (1 / 200, "{:.4e}"),
        (1 / 128, "{:.3f}"),
    ],
)
@pytest.mark.parametrize("count", [4001, 9000])
def test_times_that_are_rounded(tmp_path, dt, form, count):
    times = [form.format(k * dt) for k in range(count)]
    wave = np.sin(np.arange(count) / 20 * np.pi)
    path = table(tmp_path, "time [s],acc [g]", times, wave)
    assert rj.read_motion(path).dt == pytest.approx(dt, rel=1e-12)
    assert rj.read_motion(path, dt=dt).dt == pytest.approx(dt, rel=1e-12)
    with pytest.raises(ValueError, match=r"s apart, but dt = 0\.02 s was given"):
        rj.read_motion(path, dt=0.02)


def test_times_in_float32(tmp_path):
    times = np.float32(-113.17 + 0.01 * STEPS)
    path = table(tmp_path, "time [s],acc [g]", [str(t) for t in times], WAVE)
    assert rj.read_motion(path).dt == pytest.approx(0.01, rel=1e-12)
    np.save(tmp_path / "a.npy", np.stack([times, np.float32(WAVE)], axis=1))
    assert rj.read_motion(tmp_path / "a.npy", units="g").dt == pytest.approx(0.01, rel=1e-6)


def test_missing_rows_are_a_gap(tmp_path):
    for form, missing in (("{:.4f}", range(100, 120)), ("{:.7g}", [57]), ("{:.2f}", range(390, 395))):
        rows = [k for k in STEPS if k not in missing]
        path = table(tmp_path, None, [form.format(k / 100) for k in rows], WAVE[rows])
        with pytest.raises(
            ValueError, match=rf"a\.csv:{missing[0] + 1}: .*{len(missing)} samples are missing"
        ):
            rj.read_motion(path, units="g")


@pytest.mark.parametrize("rows", [[1000], [1], [1999], [500, 501], [300, 1500], [100, 900, 1700]])
@pytest.mark.parametrize("is_repeated", [False, True])
@pytest.mark.parametrize(("dt", "form"), [(0.01, "{:.2f}"), (0.02, "{:.2f}"), (0.005, "{:.3f}")])
def test_gaps_and_repeated_rows_in_long_records(tmp_path, rows, is_repeated, dt, form):
    """The last digit of the times may be as long as a step."""
    indices = np.sort(np.append(np.arange(2001), rows)) if is_repeated else np.delete(np.arange(2001), rows)
    times = [form.format(k * dt) for k in indices]
    path = table(tmp_path, "time [s],acc [g]", times, np.sin(indices / 20 * np.pi))
    problem = "resample" if is_repeated else "are missing"
    first = rows[0] + (3 if is_repeated else 2)
    with pytest.raises(ValueError, match=rf"a\.csv:{first}: times must rise .*{problem}"):
        rj.read_motion(path)


def test_times_whose_last_digits_are_cut_off(tmp_path):
    times = [f"{int(k / 300 * 1e4 + 1e-9) / 1e4:.4f}" for k in STEPS]
    assert rj.read_motion(table(tmp_path, None, times, WAVE), units="g").dt == pytest.approx(1 / 300)


def test_quoted_decimal_commas(tmp_path):
    rows = [f'"{k / 100:.2f}";"{y:.6f}"\n' for k, y in zip(STEPS, WAVE, strict=True)]
    path = tmp_path / "a.csv"
    path.write_text('"time [s]","acc [g]"\n' + "".join(rows).replace(".", ",").replace(";", ","))
    motion = rj.read_motion(path)
    np.testing.assert_allclose(motion.acceleration, G * WAVE, atol=1e-5)
    assert motion.dt == pytest.approx(0.01, rel=1e-12)


@pytest.mark.parametrize("separator", [";", "\t", " ", " ; "])
def test_decimal_commas(tmp_path, separator):
    path = table(tmp_path, f"Zeit{separator}Beschl", 0.01 * STEPS, WAVE, separator=separator, decimal=",")
    motion = rj.read_motion(path, units="g")
    np.testing.assert_allclose(motion.acceleration, G * WAVE, atol=1e-7)
    assert motion.dt == pytest.approx(0.01, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Zeit;Beschl\n0,00;0.1\n0,01;0.2\n", [":2:", "both commas and points", "decimal points"]),
        ("Zeit;Beschl\n0,00;1.234,5\n0,01;0,2\n", [":2:", "both commas and points", "thousands"]),
        ("time [s],acc [g]\n0,00,0,10\n0,01,0,12\n", [":1:", "does not name 4 columns", "not commas"]),
        ("0.0,1\n0.0,2\n0.1,3\n0.1,4\n", [":2:", "write them with more digits, or resample"]),
        ("0,10\n0,12\n0,11\n", [":2:", "if the commas are decimal"]),
        (
            "Beschl\n0,10\n0,12\n0,11\n",
            [":1:", "'Beschl' does not name 2 columns", "decimal points, not commas"],
        ),
        ("t,a\n0.00,1\n0.01,NaN\n", [":3:", "'NaN'", "a missing value"]),
        ("t,a,b\n0.00,1,2\n0.01,,3\n", [":3:", "'' is not a number (a missing value)"]),
        ("t,a\n0.00,1\n0.01,\n", [":3:", "'' is not a number (a missing value)"]),
        ("t,a\n0.00,1\n0.01,******\n", [":3:", "did not fit into its column"]),
        ("time,acc\n0.00,1\n0.0x,2\n", [":3:", "'0.0x' is not a number"]),
    ],
)
def test_tables_that_cannot_be_read_say_why(tmp_path, text, words):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(ValueError) as error:
        rj.read_motion(path, units="g", dt=0.01)
    assert str(error.value).startswith(f"{path}:")
    assert all(word in str(error.value) for word in words), error.value


@pytest.mark.parametrize(
    "names", [("N", "E", "Z"), ("1", "2", "3"), ("E", "N", "U"), ("N [g]", "E [g]", "Z [g]")]
)
def test_channels_with_the_shortest_names(tmp_path, names):
    path = table(tmp_path, ",".join(("time", *names)), 0.01 * STEPS, WAVE, 2 * WAVE, 3 * WAVE)
    for k, name in enumerate(names, 1):
        for component in (k, name.removesuffix(" [g]")):
            motion = rj.read_motion(path, units="g", component=component)
            np.testing.assert_allclose(motion.acceleration, k * G * WAVE, atol=1e-6)
    path = table(tmp_path, "N,acc [g]", STEPS, WAVE)  # N counts samples
    assert rj.read_motion(path, dt=0.01).pga == pytest.approx(G)


def test_one_channel_of_several(tmp_path):
    columns = [0.01 * STEPS, WAVE, 2 * WAVE, 3 * WAVE]
    for heading in (
        "time [s],N-S [g],E-W [g],U-D [g]",
        "t,Acc N-S (g),Acc E-W (g),Acc U-D (g)",
        "Time / s,acc_NS / g,acc_EW / g,acc_UD / g",
    ):
        path = table(tmp_path, heading, *columns)
        for component, factor in ((1, 1), ("NS", 1), (2, 2), ("E-W", 2), ("ud", 3), ("Up", 3), ("VERT", 3)):
            motion = rj.read_motion(path, component=component)
            np.testing.assert_allclose(motion.acceleration, factor * G * WAVE, atol=1e-6)
            assert motion.dt == pytest.approx(0.01, rel=1e-12)
        with pytest.raises(ValueError, match=r"has 3 channels: 1 \(.*S\), 2 \(.*W\), 3 \(.*D\); choose one"):
            rj.read_motion(path)
    path = table(tmp_path, None, *columns)
    with pytest.raises(ValueError, match=r"has 4 columns and no headings; .*--component"):
        rj.read_motion(path, units="g")
    np.testing.assert_allclose(
        rj.read_motion(path, units="g", component=2).acceleration, 2 * G * WAVE, atol=1e-6
    )
    path = table(tmp_path, "NS,EW", WAVE, 2 * WAVE)
    assert rj.read_motion(path, units="g", component="EW", dt=0.02).pga == pytest.approx(2 * G)
    with pytest.raises(ValueError, match="has no column of times; give dt"):
        rj.read_motion(path, units="g", component="EW")
    path = table(
        tmp_path, "time [s],acc [g],vel [cm/s],disp [cm]", *columns
    )  # one of them is an acceleration
    np.testing.assert_allclose(rj.read_motion(path).acceleration, G * WAVE, atol=1e-6)
