"""Ground motions from files: what can be read, and one clear line for what cannot."""

import tomllib

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import optimise._problem as problem
import rockjax as rj
from rockjax._readers import read

G = 9.80665
AT2 = """PEER NGA STRONG MOTION DATABASE RECORD
SOMEWHERE 01/01/01 00:00, STATION, 090
ACCELERATION TIME SERIES IN UNITS OF G
NPTS=    7, DT=   .0050 SEC
  -.1234E-02  .5000E+00  -.2500D+00   .1E-1   0.0
   1.0E-3  -2
"""
VALUES = np.array([-0.1234e-2, 0.5, -0.25, 0.01, 0.0, 1e-3, -2.0])


def put(tmp_path, text, name="motion.txt"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_at2(tmp_path):
    for text in (AT2, AT2.replace("NPTS=    7, DT=   .0050 SEC", "   7   0.0050   NPTS, DT"), AT2.replace("\n", "\r\n")):
        record = rj.Record.from_file(put(tmp_path, text, "RSN1.AT2"), scale=2.0)
        np.testing.assert_allclose(record.acceleration, G * VALUES, rtol=1e-15)
        assert float(record.dt) == 0.005
        assert float(record.scale) == 2.0
    nameless = put(tmp_path, AT2.replace("IN UNITS OF G", ""), "old.at2")
    np.testing.assert_allclose(rj.Record.from_file(nameless, units="cm/s2").acceleration, 0.01 * VALUES, rtol=1e-15)


@pytest.mark.parametrize(
    "text",
    [
        "0.00, 1\n0.02, -2\n0.04, 3\n",
        "time;acceleration\n0.00;1\n0.02;-2\n0.04;3",
        "# made up\n\ntime [s]  a\n0.00 1\n0.02\t-2\n% and\n0.04  3\n",
        "\ufeff0.00,1\r\n0.02,-2\r\n0.04,3\r\n",
    ],
)
def test_two_columns(tmp_path, text):
    record = rj.Record.from_file(put(tmp_path, text), units="m/s2")
    np.testing.assert_array_equal(record.acceleration, [1.0, -2.0, 3.0])
    assert float(record.dt) == pytest.approx(0.02)


def test_one_column_and_numpy(tmp_path):
    path = put(tmp_path, "acc\n1\n-2\n3\n")
    np.testing.assert_allclose(rj.Record.from_file(path, units="g", dt=0.01).acceleration, [G, -2 * G, 3 * G])
    np.save(tmp_path / "a.npy", np.array([1.0, -2.0, 3.0]))
    np.testing.assert_array_equal(
        rj.Record.from_file(tmp_path / "a.npy", units="gal", dt=0.01).acceleration, [0.01, -0.02, 0.03]
    )
    np.save(tmp_path / "b.npy", np.array([[0, 1], [2, 3], [4, 5]]))
    assert float(rj.Record.from_file(tmp_path / "b.npy", units="m/s2").dt) == 2.0


@pytest.mark.parametrize(
    ("name", "text", "arguments", "words"),
    [
        ("a.AT2", AT2.replace("-2", ""), {}, [":4:", "NPTS is 7", "6 values", "cut short"]),
        ("a.AT2", AT2 + "1.0\n", {}, [":4:", "NPTS is 7", "8 values"]),
        ("a.AT2", AT2.replace(".1E-1", "oops"), {}, [":5:", "'oops' is not a number"]),
        ("a.AT2", AT2.replace(".1E-1", "NaN"), {}, [":5:", "'NaN'", "finite"]),
        ("a.AT2", AT2.replace(".1E-1", "1_0"), {}, [":5:", "'1_0'"]),
        ("a.AT2", AT2.replace("UNITS OF G", "UNITS OF FURLONGS"), {}, ["'FURLONGS'", "units='g'"]),
        ("a.AT2", AT2.replace("IN UNITS OF G", ""), {}, ["does not give the unit"]),
        ("a.AT2", AT2, {"units": "m/s2"}, ["unit as g", "leave units out"]),
        ("a.AT2", AT2, {"dt": 0.01}, [":4:", "DT is 0.005", "leave dt out"]),
        ("a.AT2", AT2.replace(".0050", ".0000"), {}, [":4:", "DT must be > 0"]),
        ("a.AT2", "1 2 3\n4 5 6\n", {"units": "g"}, ["no line with NPTS and DT"]),
        ("a.txt", "", {"units": "g"}, ["is empty"]),
        ("a.txt", " \n\n", {"units": "g"}, ["is empty"]),
        ("a.txt", "# only words\n", {"units": "g"}, ["holds no numbers"]),
        ("a.txt", b"\x89PNG\r\n\x1a\n\x00\x00", {"units": "g"}, [":2:", "is not text", "0x1a"]),
        ("a.txt", "0 1\n0.1 2\n0.2\n", {"units": "g"}, [":3:", "1 columns", "have 2"]),
        ("a.txt", "0 1\n0.1 2\n0.2 x\n", {"units": "g"}, [":3:", "'x' is not a number"]),
        ("a.txt", "0 1\n0.1 2\n0.2 inf\n", {"units": "g"}, [":3:", "finite"]),
        ("a.txt", "0 1\n0.1 2\n0.3 3\n", {"units": "g"}, [":2:", "equal steps", "resample"]),
        ("a.txt", "0 1\n0 2\n0 3\n", {"units": "g"}, ["equal steps"]),
        ("a.txt", "0 1\n0.1 2\n0.2 3\n", {"units": "g", "dt": 0.2}, ["dt = 0.2", "0.1 s apart"]),
        ("a.txt", "0 1\n0.1 2\n", {}, ["does not say in what units", "units='g'"]),
        ("a.txt", "0 1\n0.1 2\n", {"units": "ft/s2"}, ["units must be one of", "'ft/s2'"]),
        ("a.txt", "1\n2\n", {"units": "g"}, ["dt is missing"]),
        ("a.txt", "1\n2\n", {"units": "g", "dt": -1.0}, ["dt must be", "-1.0"]),
        ("a.txt", "1\n", {"units": "g", "dt": 0.1}, ["holds 1 sample", "at least two"]),
        ("a.txt", "1 2 3\n4 5 6\n", {"units": "g"}, ["3 columns"]),
        ("a.npy", b"not numpy", {"units": "g", "dt": 0.1}, ["is not a NumPy array"]),
    ],
)
def test_what_cannot_be_read_says_why(tmp_path, name, text, arguments, words):
    path = put(tmp_path, text, name)
    with pytest.raises(ValueError) as error:
        rj.Record.from_file(path, **arguments)
    message = str(error.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    for word in words:
        assert word in message


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(ValueError, match=r"none\.txt: cannot be read: No such file"):
        rj.Record.from_file(tmp_path / "none.txt", units="g")
    with pytest.raises(ValueError, match="cannot be read"):
        rj.Record.from_file(tmp_path, units="g")


def one_line_or_good(path, make):
    """Either it can be read, or it is a `ValueError` of one line that begins with the file."""
    try:
        return make()
    except ValueError as error:
        message = str(error)
    assert message.startswith(str(path)), message
    assert "\n" not in message
    return None


def damaged(text: str):
    """A file with a piece cut out, put in, or repeated."""
    raw = text.encode()
    place = st.integers(0, len(raw))
    pieces = st.one_of(
        st.binary(max_size=12), st.text(max_size=8).map(str.encode), st.sampled_from([b"nan", b"1e999", b"-", b"\n"])
    )
    return st.tuples(place, place, pieces).map(lambda t: raw[: t[0]] + t[2] + raw[t[1] :])


@settings(max_examples=300, deadline=None, derandomize=True)
@given(content=st.one_of(damaged(AT2), st.binary(max_size=200)), units=st.sampled_from([None, "g"]))
@example(content=b"NPTS= 1, DT= 1e9999\n1 2", units="g")
@example(content=b"NPTS=" + b"9" * 5000 + b", DT= 1\n1 2", units="g")
def test_damaged_at2_files(tmp_path_factory, content, units):
    path = put(tmp_path_factory.getbasetemp(), content, "fuzz.at2")
    motion = one_line_or_good(path, lambda: read(path, units, None))
    if motion is not None:
        assert np.isfinite(motion.acceleration).all()
        assert len(motion.acceleration) >= 2
        assert motion.dt > 0


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    content=st.one_of(
        damaged("t,a\n0.0,1\n0.1,-2\n0.2,3\n0.3,4e-3\n"), st.binary(max_size=200), st.text(max_size=80).map(str.encode)
    ),
    dt=st.sampled_from([None, 0.1]),
    suffix=st.sampled_from(["txt", "csv", "npy"]),
)
def test_damaged_tables(tmp_path_factory, content, dt, suffix):
    path = put(tmp_path_factory.getbasetemp(), content, f"fuzz.{suffix}")
    motion = one_line_or_good(path, lambda: read(path, "g", dt))
    if motion is not None:
        assert np.isfinite(motion.acceleration).all()
        assert len(motion.acceleration) >= 2
        assert motion.dt > 0


PROBLEM = """starts = 2
[structure]
alpha = 0.15
R = 2.0
[vary]
alpha = [0.05, 0.4]
[motions.pulses]
kind = "ricker"
a_p = [3.0, 4.0]
T_p = 0.9
[minimise]
quantity = "alpha"
[[targets]]
kind = "peak-rotation"
limit = 0.4
motions = "pulses"
[options]
rtol = 1e-7
"""


@settings(max_examples=200, deadline=None, derandomize=True)
@given(content=damaged(PROBLEM))
def test_damaged_problems(tmp_path_factory, content):
    path = put(tmp_path_factory.getbasetemp(), content, "fuzz.toml")
    found = one_line_or_good(path, lambda: problem.load(path))
    assert found is None or found.targets or found.minimise


VALUES_OF_KEYS = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 3), st.floats(), st.text(max_size=5), st.lists(st.floats(), max_size=3),
    st.lists(st.text(max_size=3), max_size=2), st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
)  # fmt: skip


def leaves(table, path=()):
    for key, value in table.items():
        yield (*path, key)
        if isinstance(value, dict):
            yield from leaves(value, (*path, key))
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for k, entry in enumerate(value):
                yield from leaves(entry, (*path, key, k))


@settings(max_examples=300, deadline=None, derandomize=True)
@given(where=st.sampled_from(list(leaves(tomllib.loads(PROBLEM)))), value=VALUES_OF_KEYS)
def test_problems_with_a_value_of_the_wrong_kind(where, value):
    table = tomllib.loads(PROBLEM)
    at = table
    for key in where[:-1]:
        at = at[key]
    at[where[-1]] = value
    one_line_or_good("problem.toml", lambda: problem._Reader(problem.Path("problem.toml")).problem(table))
