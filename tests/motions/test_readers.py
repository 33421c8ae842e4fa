"""Ground motions from files: valid files are read, and invalid ones raise an error of one clear line."""

import gzip
import sys
import tomllib
import warnings

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import optimise._problem as problem
import rockjax as rj
from rockjax._motions.files import read

G = 9.80665
AT2 = """PEER NGA STRONG MOTION DATABASE RECORD
SOMEWHERE 01/01/01 00:00, STATION, 090
ACCELERATION TIME SERIES IN UNITS OF G
NPTS=    7, DT=   .0050 SEC
  -.1234E-02  .5000E+00  -.2500D+00   .1E-1   0.0
   1.0E-3  -2
"""
VALUES = np.array([-0.1234e-2, 0.5, -0.25, 0.01, 0.0, 1e-3, -2.0])


def numbers(values, per_line, width, digits):
    words = [f"{value:{width}.{digits}f}" for value in values]
    return ["".join(words[k : k + per_line]) for k in range(0, len(words), per_line)]


def csmip(channels, digits=5, units=", in cm/sec2. (8f10.5)"):
    """Return a file of CSMIP, volume 2: values in cm/s², columns of ten characters that may touch."""
    lines = []
    for number, (name, values) in enumerate(channels.items(), start=1):
        v = np.cumsum(values) * 0.02
        lines += [
            f"Corrected accelerogram   15481673.CI.WLT.--.HN      Chan {number:2d}: {name:<10s}   from   ",
            "Uncorrected Accelerogram Data             Processed: 04/30/14, CGS  ciwlt1      ",
            "La Habra Earthquake                                (Avol1 v0.6, 3/14 CSMIP)  ",
            "                                        (Origin:  To be determined)             ",
            "15481673.CI.WLT.--.HN                Start time:  3/29/14, 04:09:34.0 UTC (GPS) ",
            "Station Id. WLT     34.009N, 117.951W            s/n 4310  (3 Chns of  3 at Sta)",
            "Hacienda Heights                         SCSN   Data: Acceleration              ",
            f"Chan {number:2d}: {name}",
            *[""] * 6,
            "Accelerogram bandpass filtered with 3 dB pts at   .10 and 23.00 cyc/sec         ",
            *[""] * 10,
            *numbers(np.arange(100), 16, 5, 0),
            *numbers(np.arange(100), 8, 10, 3),
            f"{len(values):6d} points of accel data equally spaced at  .020 sec{units}    ",
            *numbers(values, 8, 10, digits),
            f"{len(values):6d} points of veloc data equally spaced at  .020 sec, in cm/sec.  (8f10.6)    ",
            *numbers(v, 8, 10, 6),
            f"/&  ----------  End of data for channel {number:2d}  ----------",
        ]
    return "\n".join([*lines, ""])


def cosmos(channels, interval_ms=5.0, form="8F10.5"):
    """Return a file of COSMOS 1.20: text, integer header, real header, comments, data; velocity after
    acceleration."""
    lines = []
    reals = np.full(100, -999.0)
    reals[61] = interval_ms
    for number, (name, values) in enumerate(channels.items(), start=1):
        for kind, unit in (("acceleration", "cm/sec2(04)"), ("velocity", "cm/sec(05)")):
            lines += [
                f"Corrected {kind}    (Format v01.20 with 13 text lines)",
                "Record of Point MacKenzie Earthquake of Fri Nov 30, 2018 17:29 UTC",
                "Hypocenter: 61.34640 -149.95520 H= 46km Mw=7.0",
                "Origin: 2018/11/30 17:29:29    UTC",
                "Statn No: 37-000011 Code:AK-BMR     UAF  Bremner River, AK, USA",
                "Coords: 60.9677 -144.6051  Site geology:",
                "Recorder: (see cmnt)      ( ? Chns of   3 at Sta) Sensor: (see comment)    ",
                "Rcrd start time: 2018/11/30 17:29:39.137 UTC (Q=5) RcrdId: (see comment)",
                f"Sta Chan {number:3d}:{name}   (Rcrdr Chan  ?) Location:",
                "Raw record length = 210.000 sec, Uncor max =    101730, at  82.680 sec.",
                "Processed:2019-03-03 05:46:55 GMT, UNKN, Max =   -6.852 cm/sec2 at   76.215 sec",
                "Record filtered below  0.03 Hz (periods over 33.33 secs), and above 20.0 Hz",
                "Values used when parameter or data value is unknown/unspecified:   -999, -999.00",
                " 100 Integer-header values follow on  10 lines, Format= (10I8)",
                *numbers(np.full(100, -999), 10, 8, 0),
                " 100 Real-header values follow on  20 lines, Format= (5F15.6)",
                *numbers(reals, 5, 15, 6),
                '   1 Comment line(s) follow, each starting with a "|":',
                "| Sensor: KINEMETRICS EPISENSOR ES-T",
                f"{len(values):8d} {kind} pts, approx  210 secs, units={unit},Format=({form})",
                *numbers(values, int(form[0]), 10, 5),
                f"End-of-data for Chan {number:2d} {kind}",
            ]
    return "\n".join([*lines, ""])


def esm(values, **changes):
    """Return a file of the Engineering Strong-Motion database (DYNA 1.2): a shortened header, and one value a
    line in cm/s²."""
    header = {
        "EVENT_NAME": "GREECE",
        "EVENT_ID": "EMSC-20190728_0000106",
        "EVENT_DATE_YYYYMMDD": "20190728",
        "MAGNITUDE_W": "",
        "NETWORK": "HI",
        "STATION_CODE": "ARS1",
        "VS30_M/S": "",
        "SAMPLING_INTERVAL_S": "0.005000",
        "NDATA": str(len(values)),
        "STREAM": "HNE",
        "UNITS": "cm/s^2",
        "PGA_CM/S^2": "0.300022",
        "FILTER_ORDER": "2",
        "LOW_CUT_FREQUENCY_HZ": "0.100",
        "HIGH_CUT_FREQUENCY_HZ": "30.000",
        "DATA_TYPE": "ACCELERATION",
        "ORIGINAL_DATA_MEDIATOR": "http://eida.gein.noa.gr/",
        "USER5": "",
    } | changes
    return "\n".join(
        [*(f"{key}: {value}" for key, value in header.items()), *(f"{a:.6f}" for a in values), ""]
    )


def knet(counts, direction="E-W", factor="2000(gal)/8388608"):
    """Return a file of K-NET and KiK-net: keys in 18 columns, then eight counts a line."""
    keys = {
        "Origin Time": "1996/08/11 03:12:00",
        "Lat.": "38.920",
        "Long.": "140.630",
        "Depth. (km)": "7",
        "Mag.": "5.9",
        "Station Code": "AKT013",
        "Station Lat.": "39.6069",
        "Station Long.": "140.3213",
        "Station Height(m)": "34",
        "Record Time": "1996/08/11 03:12:39",
        "Sampling Freq(Hz)": "100Hz",
        "Duration Time(s)": f"{len(counts) / 100:g}",
        "Dir.": direction,
        "Scale Factor": factor,
        "Max. Acc. (gal)": "4.383",
        "Last Correction": "1996/08/11 03:00:00",
        "Memo.": "",
    }
    rows = [counts[k : k + 8] for k in range(0, len(counts), 8)]
    return "\n".join(
        [*(f"{k:<18s}{v}" for k, v in keys.items()), *("".join(f"{c:8d} " for c in row) for row in rows), ""]
    )


# Without drift, positive and negative values are equal.
GALS = np.concatenate([np.linspace(-260, 260, 53), -np.linspace(-260, 260, 53)])
VERTICAL = 0.5 * GALS
CHANNELS = {"90 Deg": GALS, "Up": VERTICAL}


def smc(values, kind="2 CORRECTED ACCELEROGRAM", rate=50.0, comments=2):
    """Return a file of SMC: 11 lines of text, 48 integers, 50 reals, comments, values in cm/s² that touch."""
    texts = [
        kind, "*", "A020B", "     1989  10  18    0004 Loma Prieta, "
                            "CA", "Moment Mag=      7.1 Ms=      7.1 Ml=      7.0",
        "station = APEEL Array #2 - Redwood City  component=   "
        "up", "epicentral dist =     63.0       pk     =     84.5",
        "inst type=SMA-1      data source = USGS", "*", "*", "*",
    ]  # fmt: skip
    integers, reals = np.full(48, -32768), np.full(50, 1.7e38)
    integers[15], integers[16], reals[1] = comments, len(values), rate
    lines = [f"{text:<80s}" for text in texts]
    lines += ["".join(f"{y:10d}" for y in row) for row in integers.reshape(6, 8)]
    lines += ["".join(f"{y:15.7E}" for y in row) for row in reals.reshape(10, 5)]
    lines += [f"|a remark {k}" for k in range(comments)]
    words = [f"{y:10.3f}" for y in values]
    return "\n".join([*lines, *("".join(words[k : k + 8]) for k in range(0, len(words), 8)), ""])


def geonet(channels, first="Corrected accelerogram 20180212_211554_WPWS_20 GNS Science"):
    """Return a file of GeoNet, volume 2: acceleration, velocity, displacement in mm and s, ten values a line,
    for each component."""
    lines = []
    for name, values in channels.items():
        integers = np.zeros(40, int)
        integers[33:36] = len(values)
        lines += [
            first, "Site WPWS      39 56 38S  176 35 04E     Basalt file:  "
                   "20180212_211557_WPWS", "Waipawa District Council",
            "Instrument Basalt_2413", "Resolution: 24-bit   Instr Period: 0.0050 s   Damping: 0.700",
            "Accelerogram 20180212_211554_WPWS_20                 Processed 2018 February "
            "21", "6 km south of Waipukurau",
            "2018 February 12         21:15:54 "
            "UT", "Epicentre  40 03 27S 176 32 45E  Bearing S15W  Dist   13km  M  4.17",
            f"Number of points  "
            f"{len(values)}    Duration 115.98 sec", "Instrument corrected data at 0.020 sec intervals",
            "Band-pass filter transition bands are .10-.25 Hz and 24.50-25.50 Hz",
            f"Component {name}  Longitudinal Accelerometer Axis",
            f"Acceleration:  peak {np.abs(values).max():8.1f} mm/s/s at  43.68 sec     rms      2.2 mm/s/s",
            "Velocity:      peak     1.65 mm/s   at  43.56 "
            "sec", "Displacement:  peak    0.131 mm     at  43.66 sec",
        ]  # fmt: skip
        lines += ["".join(f"{y:8d}" for y in row) for row in integers.reshape(4, 10)]
        lines += numbers(np.zeros(60), 10, 8, 2)
        for block in (values, np.zeros(len(values)), np.zeros(len(values))):
            lines += numbers(block, 10, 8, 1)
    return "\n".join([*lines, ""])


def afad(columns, peaks=None):
    """Return a file in the older text format of AFAD: three components side by side, peaks in gal in the
    header."""
    values = np.stack(columns, axis=1)
    peaks = np.abs(values).max(axis=0) if peaks is None else peaks
    names = ("N-S", "E-W", "U-D")
    lines = [
        "STRONG GROUND MOTION RECORDS OF "
        "TURKIYE", "PLACE                   : KÜTAHYA GEDIZ METEOROLOJI MUDURLUGU",
        "EARTHQUAKE DATE         : 2017/07/20 22:31:09 (GMT)", "STATION ID              : 4304",
        f"NUMBER OF DATA          : {len(values)}", "SAMPLING INTERVAL (sec) : 0.01",
        "RAW PGA VALUES (gal)    : " + " ".join(f"({n}) {y:.6f}" for n, y in zip(names, peaks, strict=True)),
        "Copyright EARTHQUAKE DEPARTMENT", "DISASTER AND EMERGENCY MANAGEMENT PRESIDENCY",
        "       N-S          E-W          U-D",
    ]  # fmt: skip
    return "\n".join([*lines, *("".join(f"{y:13.6f}" for y in row) for row in values), ""])


def write_file(tmp_path, text, name="motion.txt"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.filterwarnings("ignore::rockjax.RecordWarning")
def test_at2(tmp_path):
    for text in (
        AT2,
        AT2.replace("NPTS=    7, DT=   .0050 SEC", "   7   0.0050   NPTS, DT"),
        AT2.replace("\n", "\r\n"),
    ):
        record = rj.Record.from_file(write_file(tmp_path, text, "RSN1.AT2"), scale=2.0)
        np.testing.assert_allclose(record.acceleration, G * VALUES, rtol=1e-15)
        assert float(record.dt) == 0.005
        assert float(record.scale) == 2.0
    nameless = write_file(tmp_path, AT2.replace("IN UNITS OF G", ""), "old.at2")
    np.testing.assert_allclose(
        rj.Record.from_file(nameless, units="cm/s2").acceleration, 0.01 * VALUES, rtol=1e-15
    )


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
    record = rj.Record.from_file(write_file(tmp_path, text), units="m/s2")
    np.testing.assert_array_equal(record.acceleration, [1.0, -2.0, 3.0])
    assert float(record.dt) == pytest.approx(0.02)


@pytest.mark.filterwarnings("ignore::rockjax.RecordWarning")
def test_one_column_and_numpy(tmp_path):
    path = write_file(tmp_path, "acc\n1\n-2\n3\n")
    np.testing.assert_allclose(rj.Record.from_file(path, units="g", dt=0.01).acceleration, [G, -2 * G, 3 * G])
    np.save(tmp_path / "a.npy", np.array([1.0, -2.0, 3.0]))
    np.testing.assert_array_equal(
        rj.Record.from_file(tmp_path / "a.npy", units="gal", dt=0.01).acceleration, [0.01, -0.02, 0.03]
    )
    np.save(tmp_path / "b.npy", np.array([[0, 1], [2, 3], [4, 5]]))
    assert float(rj.Record.from_file(tmp_path / "b.npy", units="m/s2").dt) == 2.0


@pytest.mark.parametrize(
    ("name", "text", "dt", "output"),
    [
        (
            "a.V2",
            csmip(CHANNELS),
            0.02,
            {"station": "WLT Hacienda Heights", "date": "3/29/14", "event": "La Habra Earthquake"},
        ),
        (
            "a.v2",
            csmip(CHANNELS, 3, ".  (UNITS: CM/SEC/SEC)").upper(),
            0.02,
            {"low_pass_Hz": 23.0, "high_pass_Hz": 0.1},
        ),
        ("a.V2c", cosmos(CHANNELS), 0.005, {"date": "2018/11/30", "high_pass_Hz": 0.03, "low_pass_Hz": 20.0}),
        ("a.txt", cosmos(CHANNELS, form="1F10.5"), 0.005, {"station": "AK-BMR UAF Bremner River, AK, USA"}),
    ],
)
def test_several_channels(tmp_path, name, text, dt, output):
    path = write_file(tmp_path, text, name)
    for component, values in ((1, GALS), ("90 deg", GALS), ("90", GALS), (2, VERTICAL), ("up", VERTICAL)):
        motion = rj.read_motion(path, component=component)
        np.testing.assert_allclose(motion.acceleration, 0.01 * values, rtol=0, atol=1e-5)
        assert motion.dt == pytest.approx(dt, rel=1e-12)
        assert motion.metadata["component"].casefold() == ("up" if values is VERTICAL else "90 deg")
        assert motion.metadata["units"] == "cm/s2"
        assert output.items() <= motion.metadata.items()
    np.testing.assert_array_equal(rj.Record.from_file(path, component=2).acceleration, motion.acceleration)
    for wrong in (None, 3, "North"):
        with pytest.raises(
            ValueError, match=r"has 2 channels.*1 \(90 [Dd][Ee][Gg]\), 2 \([Uu][Pp]\); choose"
        ):
            rj.read_motion(path, component=wrong)


def test_columns_that_touch(tmp_path):
    values = np.tile([-123.45678, -987.65432, 987.65432, 123.45678], 10)
    text = csmip({"UP": values})
    assert "-123.45678-987.65432" in text
    motion = rj.read_motion(write_file(tmp_path, text, "a.v2"))
    np.testing.assert_allclose(motion.acceleration, 0.01 * values, rtol=1e-14)


def test_esm(tmp_path):
    path = write_file(tmp_path, esm(GALS), "HI.ARS1..HNE.D.20190728.160908.C.ACC.ASC")
    motion = rj.read_motion(path)
    np.testing.assert_allclose(motion.acceleration, 0.01 * GALS, rtol=1e-14)
    assert motion.dt == 0.005
    assert motion.name == path.stem
    assert motion.source == path
    output = {
        "station": "HI.ARS1",
        "component": "HNE",
        "date": "20190728",
        "low_pass_Hz": 30.0,
        "filter_order": "2",
    }
    assert output.items() <= motion.metadata.items()


def test_knet(tmp_path):
    counts = [round(8388608 / 2000 * a) for a in GALS]
    path = write_file(tmp_path, knet(counts), "AKT0139608110312.EW")
    with pytest.warns(rj.RecordWarning, match=r"312\.EW: the motion is raw \(as all K-NET data\)"):
        motion = rj.read_motion(path)
    np.testing.assert_allclose(motion.acceleration, 20 * np.array(counts) / 8388608, rtol=1e-14)
    assert motion.dt == 0.01
    assert {
        "station": "AKT013",
        "component": "E-W",
        "event": "M 5.9",
        "Lat.": "38.920",
    }.items() <= motion.metadata.items()
    borehole = read(write_file(tmp_path, knet(counts, "4"), "a.NS2"), None, None, "NS2")
    assert borehole.metadata["component"] == "NS2"
    obspy = pytest.importorskip("obspy")
    trace = obspy.read(str(path), format="KNET")[0]
    np.testing.assert_allclose(motion.acceleration, trace.data * trace.stats.calib, rtol=1e-14)
    assert trace.stats.delta == motion.dt


def test_smc(tmp_path):
    motion = rj.read_motion(write_file(tmp_path, smc(GALS), "a.smc"))
    np.testing.assert_allclose(motion.acceleration, 0.01 * GALS, atol=1e-5)
    assert motion.dt == 0.02
    assert motion.metadata["station"] == "APEEL Array #2 - Redwood City"
    assert (motion.metadata["component"], motion.metadata["date"]) == ("up", "1989/10/18")
    assert motion.metadata["event"] == "Loma Prieta, CA"


def test_columns_whose_blanks_an_editor_removed(tmp_path):
    text = "\n".join(line.strip().replace("   ", "\t") for line in smc(GALS).splitlines())
    motion = rj.read_motion(write_file(tmp_path, text, "a.smc"))
    np.testing.assert_allclose(motion.acceleration, 0.01 * GALS, atol=1e-5)


@pytest.mark.filterwarnings("ignore::rockjax.RecordWarning")
def test_the_unit_of_the_interval_in_at2_files(tmp_path):
    for step in ("5 MSEC", "5.0 ms", ".0050 SEC", ".005 s", "5E-3 seconds", ".0050"):
        path = write_file(tmp_path, AT2.replace(".0050 SEC", step), "a.AT2")
        assert rj.read_motion(path).dt == pytest.approx(0.005, rel=1e-12)
    with pytest.raises(ValueError, match=r"a\.AT2:4: '0,005' is not a number; write the decimal comma"):
        rj.read_motion(write_file(tmp_path, AT2.replace(".0050 SEC", "0,005 SEC"), "a.AT2"))


def test_packed_files_are_named(tmp_path):
    for content in (gzip.compress(AT2.encode()), b"PK\x03\x04\x14\0\x06\0"):
        with pytest.raises(ValueError, match=r"a\.csv: the file is packed .*; unpack it"):
            rj.read_motion(write_file(tmp_path, content, "a.csv"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("R = 2.0", "R = 2,0"), r"a\.toml:4: .*not valid TOML: .*; write decimal commas as points"),
        (("alpha = 0.15", "alpha = 0,15"), r"a\.toml:3: .*; write decimal commas as points"),
        (('"ricker"', "“ricker”"), r"a\.toml:8: .*; write straight quotes"),
        (("[options]", "[options"), r"a\.toml:1\d: the file is not valid TOML: "),
    ],
)
def test_problems_that_are_not_valid_toml_name_line_and_cure(tmp_path, change, words):
    with pytest.raises(ValueError, match=words):
        problem.load(write_file(tmp_path, PROBLEM.replace(*change), "a.toml"))


def test_geonet(tmp_path):
    path = write_file(tmp_path, geonet({"S16W": 10 * GALS, "N74W": 5 * GALS}), "a.V2A")
    for component, values in (("S16W", GALS), (2, 0.5 * GALS)):
        motion = rj.read_motion(path, component=component)
        np.testing.assert_allclose(motion.acceleration, 0.01 * values, atol=1e-4)
        assert (motion.dt, motion.metadata["format"]) == (0.02, "GeoNet")
    assert motion.metadata["station"] == "WPWS Waipawa District Council"
    assert motion.metadata["high_pass_Hz"] == 0.25
    with pytest.raises(ValueError, match=r"has 2 channels: 1 \(S16W\), 2 \(N74W\)"):
        rj.read_motion(path)


def test_afad(tmp_path):
    """The present format, whose type is not in capitals, and the older one with three components and no
    unit."""
    new = rj.read_motion(write_file(tmp_path, esm(GALS, DATA_TYPE="Acceleration"), "a.asc"))
    np.testing.assert_allclose(new.acceleration, 0.01 * GALS, atol=1e-8)
    path = write_file(tmp_path, afad([GALS, VERTICAL, -VERTICAL]).encode("latin-1"), "a.txt")
    with pytest.warns(rj.RecordWarning, match=r"is raw \(line 7\)"):
        motion = rj.read_motion(path, component="U-D")
    np.testing.assert_allclose(motion.acceleration, -0.01 * VERTICAL, atol=1e-8)
    assert motion.dt == 0.01
    assert motion.metadata["station"] == "4304 KÜTAHYA GEDIZ METEOROLOJI MUDURLUGU"
    with pytest.raises(ValueError, match=r"has 3 channels: 1 \(N-S\)"):
        rj.read_motion(path)
    # The peaks of the columns differ from those of the header in gal.
    other = write_file(tmp_path, afad([GALS, VERTICAL, -VERTICAL], peaks=[0.27, 0.13, 0.13]), "b.txt")
    with pytest.raises(ValueError, match="the file does not state the unit of its samples"):
        rj.read_motion(other, component=1)
    assert read(other, "gal", None, 1).pga == pytest.approx(2.6)


def test_itaca_with_blanks_in_its_keys(tmp_path):
    header, _, rest = esm(GALS).partition("USER5")
    motion = rj.read_motion(write_file(tmp_path, header.replace("_", " ") + "USER5" + rest, "a.cor.acc"))
    np.testing.assert_allclose(motion.acceleration, 0.01 * GALS, atol=1e-8)


@pytest.mark.parametrize("end", [b"\x1a", b"\x1a\x1a\r\n", b"\r\n\x1a\n"])
def test_the_end_of_a_file_under_dos(tmp_path, end):
    motion = rj.read_motion(write_file(tmp_path, csmip({"Up": GALS}).encode() + end, "a.V2"))
    np.testing.assert_allclose(motion.acceleration, 0.01 * GALS, atol=1e-7)


def test_waveforms(tmp_path, monkeypatch):
    path = tmp_path / "a.mseed"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import obspy
    except ImportError:
        path.write_bytes(b"000001D ")
    else:
        traces = [
            obspy.Trace(values, {"delta": 0.01, "channel": channel, "station": "AKT"})
            for values, channel in ((GALS, "HNE"), (VERTICAL, "HNZ"))
        ]
        obspy.Stream(traces).write(str(path), format="MSEED")
        motion = rj.read_motion(path, units="gal", component="HNZ")
        np.testing.assert_allclose(motion.acceleration, 0.01 * VERTICAL, rtol=1e-14)
        assert motion.dt == pytest.approx(0.01, rel=1e-12)
        with pytest.raises(ValueError, match=r"1 \(HNE\), 2 \(HNZ\)"):
            rj.read_motion(path, units="gal")
        with pytest.raises(ValueError, match=r"a\.mseed: the file does not state the unit"):
            rj.read_motion(path, component=1)
        obspy.Stream(traces).write(
            str(tmp_path / "pickled.sac"), format="PICKLE"
        )  # unpickling could execute code
        with pytest.raises(ValueError, match=r"pickled\.sac: ObsPy cannot read the file: "):
            rj.read_motion(tmp_path / "pickled.sac", units="gal", component=1)
        with pytest.raises(ValueError, match=r"b\.sac: ObsPy cannot read the file: "):
            rj.read_motion(write_file(tmp_path, b"no waveform", "b.sac"), units="gal")
    monkeypatch.setitem(sys.modules, "obspy", None)
    with pytest.raises(
        ValueError,
        match=r"a\.mseed: \.mseed files need ObsPy; install it with: pip install 'rockjax\[records\]'",
    ):
        rj.read_motion(path, units="gal")


def test_suspicious_files_cause_warnings(tmp_path):
    wave = np.sin(2 * np.pi * np.arange(101) / 50)  # two complete periods

    def column(values):
        return write_file(tmp_path, "\n".join(f"{a:.12f}" for a in values))

    # No warning is issued.
    assert rj.read_motion(column(wave), units="m/s2", dt=0.01).pga == pytest.approx(1, rel=1e-2)
    with pytest.warns(rj.RecordWarning, match=r"motion\.txt: PGA is 99\.8 g; are the units right\?"):
        rj.read_motion(column(100 * wave), units="g", dt=0.01)
    with pytest.warns(rj.RecordWarning, match=r"motion\.txt: PGA is 1\.02e-05 g; are the units right\?"):
        rj.read_motion(column(1e-4 * wave), units="m/s2", dt=0.01)
    with pytest.warns(
        rj.RecordWarning,
        match=r"motion\.txt: the motion ends with a velocity .* 100% of PGV, .*baseline_corrected",
    ) as output:
        rj.Record.from_file(column(wave[:26]), units="m/s2", dt=0.01)
    assert output[0].filename == __file__


def test_units_in_a_heading(tmp_path):
    path = write_file(tmp_path, "time [s],acceleration [g]\n0,0\n0.1,1\n0.2,-1\n0.3,0\n", "a.csv")
    np.testing.assert_allclose(rj.read_motion(path).acceleration, G * np.array([0, 1, -1, 0]))
    with pytest.raises(ValueError, match=r"gives the unit as g, but units = m/s2 was given; leave units out"):
        rj.read_motion(path, units="m/s2")


@pytest.mark.parametrize(
    ("name", "text", "arguments", "words"),
    [
        ("a.AT2", AT2.replace("-2", ""), {}, [":4:", "NPTS is 7", "6 values", "cut short"]),
        ("a.AT2", AT2 + "1.0\n", {}, [":4:", "NPTS is 7", "8 values"]),
        ("a.AT2", AT2.replace(".1E-1", "oops"), {}, [":5:", "'oops' is not a number"]),
        ("a.AT2", AT2.replace(".1E-1", "NaN"), {}, [":5:", "'NaN'", "finite"]),
        ("a.AT2", AT2.replace(".1E-1", "1_0"), {}, [":5:", "'1_0'"]),
        (
            "a.AT2",
            AT2.replace("UNITS OF G", "UNITS OF FURLONGS"),
            {},
            ["'FURLONGS'", "give units (on the command line --units)"],
        ),
        ("a.AT2", AT2.replace("IN UNITS OF G", ""), {}, ["does not give the unit"]),
        ("a.AT2", AT2, {"units": "m/s2"}, ["unit as g", "leave units out"]),
        ("a.AT2", AT2, {"dt": 0.01}, [":4:", "DT is 0.005", "leave dt out"]),
        ("a.AT2", AT2.replace(".0050", ".0000"), {}, [":4:", "DT must be > 0"]),
        ("a.AT2", "1 2 3\n4 5 6\n", {"units": "g"}, ["needs a line with NPTS and DT"]),
        ("a.txt", "", {"units": "g"}, ["is empty"]),
        ("a.txt", " \n\n", {"units": "g"}, ["is empty"]),
        ("a.txt", "# only words\n", {"units": "g"}, ["contains no numbers"]),
        ("a.txt", b"\x89PNG\r\n\x1a\n\x00\x00", {"units": "g"}, [":2:", "is not text", "0x1a"]),
        ("a.txt", "0 1\n0.1 2\n0.2\n", {"units": "g"}, [":3:", "1 columns", "have 2"]),
        ("a.txt", "0 1\n0.1 2\n0.2 x\n", {"units": "g"}, [":3:", "'x' is not a number"]),
        ("a.txt", "0 1\n0.1 2\n0.2 inf\n", {"units": "g"}, [":3:", "finite"]),
        ("a.txt", "0 1\n0.1 2\n0.3 3\n", {"units": "g"}, [":2:", "equal steps", "resample"]),
        ("a.txt", "0 1\n0 2\n0 3\n", {"units": "g"}, ["equal steps"]),
        ("a.txt", "0 1\n0.1 2\n0.2 3\n", {"units": "g", "dt": 0.2}, ["dt = 0.2", "0.1 s apart"]),
        (
            "a.txt",
            "0 1\n0.1 2\n",
            {},
            ["the file does not state the unit of its samples", "give units (on the command line --units)"],
        ),
        ("a.txt", "0 1\n0.1 2\n", {"units": "ft/s2"}, ["units must be one of", "'ft/s2'"]),
        ("a.txt", "1\n2\n", {"units": "g"}, ["give dt"]),
        ("a.txt", "1\n2\n", {"units": "g", "dt": -1.0}, ["dt must be", "-1.0"]),
        ("a.txt", "1\n", {"units": "g", "dt": 0.1}, ["needs at least two samples, got 1"]),
        ("a.txt", "1 2 3\n4 5 6\n", {"units": "g"}, ["3 columns"]),
        ("a.npy", b"not numpy", {"units": "g", "dt": 0.1}, ["is not a NumPy array"]),
        ("a.txt", "0 1\n0.1 2\n", {"units": "g", "component": 1}, ["has one motion, not component 1"]),
        (
            "a.v2",
            csmip(CHANNELS).replace("-260.00000", "-26o.00000"),
            {"component": 1},
            [":47:", "is not a number"],
        ),
        (
            "a.v2",
            csmip(CHANNELS).replace("   106 points of accel", "   107 points of accel"),
            {"component": 1},
            [":60:", "must have"],
        ),
        (
            "a.v2",
            "\n".join(csmip(CHANNELS).split("\n")[:50]),
            {},
            [":46:", "points is 106", "32 values", "cut short"],
        ),
        (
            "a.v2",
            csmip(CHANNELS),
            {"component": 1, "dt": 0.01},
            [":46:", "interval is 0.02 s", "leave dt out"],
        ),
        (
            "a.v2",
            csmip(CHANNELS, units=", in counts. (8f10.5)"),
            {"component": 1},
            ["'counts'", "give units (on the command line --units)"],
        ),
        (
            "a.v2",
            csmip(CHANNELS).replace("points of accel", "points of a"),
            {"component": 1},
            [":1:", "no line 'N points"],
        ),
        ("a.v1", "UNCORRECTED ACCELEROGRAM DATA\n1 2\n", {}, [":1:", "volume 1", "raw", ".V2"]),
        ("a.txt", "FILE OF UNCORRECTED ACCELEROGRAM DATA OF USC\n1 2\n", {}, [":1:", "volume 1", "raw"]),
        ("a.v1c", "Raw counts of a station\n1 2\n", {}, [":1:", "volume 1", "raw"]),
        ("a.v3", "Response and Fourier amplitude spectra\nCorrected\n", {}, [":1:", "volume 3", "spectra"]),
        ("a.txt", "RESPONSE AND FOURIER AMPLITUDE SPECTRA\n1 2\n", {}, [":1:", "volume 3"]),
        (
            "a.v2",
            "\n".join(["CORRECTED ACCELEROGRAM", "", *[f"{'TEXT':<72s}40" for _ in range(10)], "1 2 3"]),
            {},
            [":1:", "volume 2 of USC", "CSMIP or COSMOS"],
        ),
        ("a.v1c", cosmos(CHANNELS).replace("Corrected acc", "Uncorrected acc"), {}, [":1:", "COSMOS", "raw"]),
        ("a.v0", cosmos(CHANNELS).replace("Corrected acc", "Raw acc"), {}, [":1:", "COSMOS", "raw"]),
        ("a.smc", smc(GALS, "1 UNCORRECTED ACCELEROGRAM"), {}, [":1:", "SMC", "raw"]),
        (
            "a.VT2",
            AT2.replace("ACCELERATION TIME", "VELOCITY TIME"),
            {"units": "g"},
            [":3:", "the file has velocity"],
        ),
        (
            "a.AT2",
            AT2.replace("ACCELERATION TIME", "Velocity time"),
            {"units": "g"},
            [":3:", "the file has velocity"],
        ),
        ("a.DT2", AT2.replace("ACCELERATION TIME SERIES", ""), {"units": "g"}, ["displacement", "not acc"]),
        ("a.AT2", AT2.replace("OF G", "OF CM/S"), {"units": "cm/s2"}, ["CM/S", "not a unit of acceleration"]),
        ("a.v2", "1 2\n3 4\n", {}, [":1:", "must begin with", "CSMIP", "COSMOS"]),
        ("a.v2c", cosmos(CHANNELS, interval_ms=-999.0), {"component": 1}, [":25:", "value 62", "> 0 ms"]),
        (
            "a.v2c",
            cosmos(CHANNELS).replace("acceleration  ", "velocity  "),
            {},
            [":1:", "the file has velocity"],
        ),
        ("a.asc", esm(GALS, NDATA="107"), {}, [":9:", "NDATA is 107", "106 values", "cut short"]),
        ("a.asc", esm(GALS, NDATA="many"), {}, [":9:", "whole number", "'many'"]),
        (
            "a.asc",
            esm(GALS, UNITS="cm"),
            {},
            ["gives the unit as 'cm'", "give units (on the command line --units)"],
        ),
        ("a.asc", esm(GALS, DATA_TYPE="VELOCITY"), {}, [":16:", "'VELOCITY'", "not ACCELERATION"]),
        (
            "a.V2A",
            geonet({"S16W": GALS}, "Uncorrected accelerogram X GNS Science"),
            {},
            [":1:", "volume 1 of GeoNet"],
        ),
        (
            "a.V2A",
            "\n".join(geonet({"S16W": GALS}).split("\n")[:30]),
            {},
            [":26:", "is 106", "40 values", "cut short"],
        ),
        ("a.V2A", geonet({"S16W": GALS}).replace("0.020 sec", "0.000 sec"), {}, [":11:", "must be > 0 s"]),
        ("a.smc", smc(GALS, "3 VELOCITY"), {}, [":1:", "the SMC file has 'velocity'"]),
        (
            "a.smc",
            smc(GALS, "1 UNCORRECTED ACCELEROGRAM"),
            {},
            [":1:", "the SMC file has 'uncorrected accelerogram'"],
        ),
        ("a.smc", smc(GALS, rate=-50.0), {}, [":18:", "samples per second", "-50"]),
        ("a.smc", "\n".join(smc(GALS).split("\n")[:33]), {}, [":29:", "is 106", "32 values", "cut short"]),
        (
            "a.txt",
            afad([GALS, VERTICAL, -VERTICAL]).replace("-260.000000", "-260.000000 1", 1),
            {"component": 1},
            ["three columns, got 4"],
        ),
        (
            "a.txt",
            afad([GALS, VERTICAL, -VERTICAL])[:-80],
            {"component": 1},
            [":5:", "NUMBER OF DATA is 106", "lines of values"],
        ),
        ("a.cor.acc", "1 2\n", {}, [":1:", "old format of ITACA", "not supported"]),
        ("a.asc", esm(GALS, SAMPLING_INTERVAL_S="0"), {}, [":8:", "must be > 0 s"]),
        ("a.asc", esm(GALS), {"component": "HNZ"}, ["not component 'HNZ'", "it is 'HNE'"]),
        ("a.EW", knet([1] * 100)[:-30], {}, [":12:", "is 100", "the file has", "cut short"]),
        ("a.EW", knet([1] * 100, factor="2000/8388608"), {}, [":14:", "Scale Factor", "2000(gal)/8388608"]),
        ("a.EW", knet([1] * 100, factor="2000(gal)/0"), {}, [":14:", "> 0"]),
        ("a.EW", knet([1] * 100).replace("Memo.", "Nemo."), {}, ["no Memo."]),
        ("a.EW", knet([10] * 100, factor="1e308(gal)/1"), {}, ["sample 1 is not a finite number"]),
        ("a.txt", "1e308\n1\n", {"units": "g", "dt": 0.1}, ["sample 1 is not a finite number"]),
        ("a.EW", knet([1] * 100).replace("100Hz", "-5Hz"), {}, [":11:", "> 0 Hz", "-5Hz"]),
    ],
)
def test_unreadable_files_name_the_reason(tmp_path, name, text, arguments, words):
    path = write_file(tmp_path, text, name)
    with pytest.raises(ValueError) as error:
        rj.Record.from_file(path, **arguments)
    message = str(error.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    for word in words:
        assert word in message


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(ValueError, match=r"none\.txt: the file cannot be read: No such file"):
        rj.Record.from_file(tmp_path / "none.txt", units="g")
    with pytest.raises(ValueError, match="cannot be read"):
        rj.Record.from_file(tmp_path, units="g")


def one_line_or_good(path, make):
    """Check that the file is read, or raises a `ValueError` of one line that begins with the file."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rj.PlausibilityWarning)  # implausible numbers are allowed
            return make()
    except ValueError as error:
        message = str(error)
    assert message.startswith(str(path)), message
    assert "\n" not in message
    return None


def one_line_or_motion(path, make):
    motion = one_line_or_good(path, make)
    if motion is not None:
        assert np.isfinite(motion.acceleration).all()
        assert len(motion.acceleration) >= 2
        assert motion.dt > 0


def damaged(text: str):
    """Return the file with a part removed, inserted or repeated."""
    raw = text.encode()
    place = st.integers(0, len(raw))
    pieces = st.one_of(
        st.binary(max_size=12),
        st.text(max_size=8).map(str.encode),
        st.sampled_from([b"nan", b"1e999", b"-", b"\n"]),
    )
    return st.tuples(place, place, pieces).map(lambda t: raw[: t[0]] + t[2] + raw[t[1] :])


@settings(max_examples=300, deadline=None, derandomize=True)
@given(content=st.one_of(damaged(AT2), st.binary(max_size=200)), units=st.sampled_from([None, "g"]))
@example(content=b"NPTS= 1, DT= 1e9999\n1 2", units="g")
@example(content=b"NPTS=" + b"9" * 5000 + b", DT= 1\n1 2", units="g")
def test_damaged_at2_files(tmp_path_factory, content, units):
    path = write_file(tmp_path_factory.getbasetemp(), content, "fuzz.at2")
    one_line_or_motion(path, lambda: read(path, units, None))


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    content=st.one_of(
        damaged("t,a\n0.0,1\n0.1,-2\n0.2,3\n0.3,4e-3\n"),
        st.binary(max_size=200),
        st.text(max_size=80).map(str.encode),
    ),
    dt=st.sampled_from([None, 0.1]),
    suffix=st.sampled_from(["txt", "csv", "npy"]),
)
def test_damaged_tables(tmp_path_factory, content, dt, suffix):
    path = write_file(tmp_path_factory.getbasetemp(), content, f"fuzz.{suffix}")
    one_line_or_motion(path, lambda: read(path, "g", dt))


SHORT_CHANNELS = {"90 Deg": GALS[::8], "Up": VERTICAL[::8]}


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    content=st.sampled_from(
        [csmip(SHORT_CHANNELS), cosmos(SHORT_CHANNELS), esm(GALS[::8]), knet([5, -5] * 50)]
    ).flatmap(damaged),
    component=st.sampled_from([None, 1, "Up"]),
    suffix=st.sampled_from(["V2", "asc", "EW"]),
)
@example(content=csmip(SHORT_CHANNELS).replace("(8f10.5)", "(0f10.5)").encode(), component=1, suffix="V2")
@example(content=csmip(SHORT_CHANNELS).replace("(8f10.5)", "(8f0.5)").encode(), component=1, suffix="V2")
@example(content=knet([1] * 8).replace("0.08", "1e300").encode(), component=None, suffix="EW")
def test_damaged_files_of_networks(tmp_path_factory, content, component, suffix):
    path = write_file(tmp_path_factory.getbasetemp(), content, f"fuzz.{suffix}")
    one_line_or_motion(path, lambda: read(path, None, None, component))


@settings(max_examples=200, deadline=None, derandomize=True)
@given(content=damaged("file,name,scale,units,dt\na.csv,one,2.0,m/s2,\na.csv,,,,0.1\n"))
@example(content=b"file\na\x00.csv\n")
def test_damaged_tables_of_files(tmp_path_factory, content):
    folder = tmp_path_factory.getbasetemp()
    write_file(folder, "0,1\n0.1,-1\n0.2,-1\n0.3,1\n", "a.csv")
    path = write_file(folder, content, "fuzz-suite.csv")
    message = ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rj.RecordWarning)
            assert len(rj.read_suite(path, units="m/s2")) >= 1
    except ValueError as error:
        message = str(error)
    assert not message or message.startswith(str(path))


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
    path = write_file(tmp_path_factory.getbasetemp(), content, "fuzz.toml")
    found = one_line_or_good(path, lambda: problem.load(path))
    assert found is None or found.targets or found.minimise


VALUES_OF_KEYS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.floats(),
    st.text(max_size=5),
    st.lists(st.floats(), max_size=3),
    st.lists(st.text(max_size=3), max_size=2),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
)


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
    one_line_or_good("problem.toml", lambda: problem.problem_of(table, problem.Path("problem.toml")))


@pytest.mark.parametrize(
    ("rows", "values"),
    [
        (" -.1000000E-01-.2000000E-01 .3000000E-01", [-0.01, -0.02, 0.03]),
        ("-0.0000000E+00-1.3561694E-305-7.1938300E-04", [0, -1.3561694e-305, -7.19383e-4]),
        ("  .1000000-101 -.2000000-101  .3000000E-01", [1e-102, -2e-102, 0.03]),
        ("1.5D-101-2.5D-01 1.0", [1.5e-101, -0.25, 1]),
        ("1.2345678E-012.2345678E-02-.5", [0.12345678, 0.022345678, -0.5]),
        ("100.123456 99.123456-99.123456", [100.123456, 99.123456, -99.123456]),
        ("100.123456200.123456 -9.123456", [100.123456, 200.123456, -9.123456]),
    ],
)
def test_columns_of_fortran_that_touch(tmp_path, rows, values):
    head = AT2.split("  -.1234")[0].replace("NPTS=    7", "NPTS= 3")
    motion = read(write_file(tmp_path, head + rows + "\n", "a.AT2"), None, None)
    np.testing.assert_allclose(motion.acceleration, G * np.array(values), rtol=1e-14)
    assert motion.dt == 0.005


@pytest.mark.parametrize(
    "pulse", [rj.Ricker(3.0, 1.0), rj.AntisymmetricRicker(-3.0, 0.7), rj.Ricker(1e-98, 2.0)]
)
def test_saved_at2_files_are_read_back(tmp_path, pulse):
    motion = rj.Motion(np.asarray(pulse(np.arange(-20, 20, 0.01))), 0.01)
    back = read(motion.save(tmp_path / "own.AT2"), None, None)
    np.testing.assert_allclose(back.acceleration, motion.acceleration, rtol=1e-7, atol=1e-98)


def test_names_do_not_change_saved_at2_files(tmp_path):
    motion = rj.Motion(GALS / 100, 0.02, "NPTS= 3, DT= 7, raw velocity", metadata={"station": "NPTS=1 DT=2"})
    back = rj.read_motion(motion.save(tmp_path / "own.AT2"))
    np.testing.assert_allclose(back.acceleration, motion.acceleration, rtol=1e-7)
    assert back.dt == motion.dt


@pytest.mark.parametrize("shape", [(0,), (0, 2), (5, 0)])
def test_empty_arrays(tmp_path, shape):
    np.save(tmp_path / "a.npy", np.zeros(shape))
    with pytest.raises(ValueError, match=r"a\.npy: the file contains no numbers"):
        rj.read_motion(tmp_path / "a.npy", units="g", dt=0.1)


@pytest.mark.filterwarnings("ignore::rockjax.RecordWarning")
@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "utf-32"])
def test_encodings_of_editors(tmp_path, encoding):
    motion = rj.read_motion(write_file(tmp_path, AT2.encode(encoding), "a.AT2"))
    np.testing.assert_allclose(motion.acceleration, G * VALUES, rtol=1e-15)
    problem_file = write_file(tmp_path, PROBLEM.encode(encoding), "a.toml")
    assert problem.load(problem_file).targets
    with pytest.raises(ValueError, match=r"b\.AT2:1: the file is not text: .* save it as UTF-8"):
        rj.read_motion(write_file(tmp_path, AT2.encode("utf-16-le"), "b.AT2"))


def test_text_that_is_not_utf_8(tmp_path):
    latin = "[structure]\n# Straße\n".encode("latin-1")
    with pytest.raises(ValueError, match=r"a\.toml:2: the text is not UTF-8: byte 0xdf .*; save"):
        problem.load(write_file(tmp_path, latin, "a.toml"))
    text = "# Straße\nPGA [g],annual_rate\n0.1,1e-2\n1,1e-4\n".encode("latin-1")
    assert rj.Hazard.from_file(write_file(tmp_path, text, "hazard.csv")).measure == "PGA"
    write_file(tmp_path, "0,0\n0.1,1\n0.2,-1\n0.3,0\n", "a.csv")
    suite = write_file(tmp_path, "file,name\na.csv,Gölcük\n".encode("cp1254"), "suite.csv")
    assert rj.read_suite(suite, units="m/s2").names == ["Gölcük"]
    pulses = write_file(tmp_path, "name,A,f_p,gamma,nu\nGölcük,1,1,2,0\n".encode("latin-1"), "pulses.csv")
    assert rj.read_pulses(pulses).names == ("Gölcük",)


@pytest.mark.parametrize("name", ["mean", "stddev"])
def test_attributes_of_openquake_with_decimal_commas(tmp_path, name):
    limits = {"mean": "0.1", "stddev": "0.08"} | {name: "0,1"}
    path = write_file(
        tmp_path,
        '<nrml xmlns="http://openquake.org/xmlns/nrml/0.5"><fragilityModel id="m">'
        "<limitStates>a</limitStates>"
        '<fragilityFunction id="A" format="continuous" shape="logncdf"><imls imt="PGA" noDamageLimit="0.05"/>'
        f'<params ls="a" mean="{limits["mean"]}" stddev="{limits["stddev"]}"/></fragilityFunction>'
        "</fragilityModel></nrml>",
        "a.xml",
    )
    with pytest.raises(ValueError, match=rf"a\.xml: A.*{name}.*'0,1'"):
        rj.read_fragility_model(path)


@pytest.mark.filterwarnings("ignore::rockjax.RecordWarning")
def test_the_format_of_peer_under_another_suffix(tmp_path):
    for name in ("a.txt", "a.csv", "RSN1.acc", "noext"):
        motion = rj.read_motion(write_file(tmp_path, AT2, name))
        np.testing.assert_allclose(motion.acceleration, G * VALUES, rtol=1e-15)
        assert motion.metadata["format"] == "PEER"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.AT2", AT2.replace("PEER", "RAW DATA, PEER")),
        ("HI.ARS1..HNE.D.20190728.160908.U.ACC.ASC", esm(GALS)),
        ("IT.AMT..HNE.D.EMSC-20160824_0000006.ACC.CV.ASC", esm(GALS)),
        ("a.asc", esm(GALS, BASELINE_CORRECTION="BASELINE NOT REMOVED")),
        ("a.asc", esm(GALS, PROCESSING="none")),
        ("a.asc", esm(GALS, DATA_TYPE="UNPROCESSED ACCELERATION")),
        ("a.csv", "time [s],acc_raw [g]\n0,0\n0.1,0.1\n0.2,-0.1\n0.3,0\n"),
        ("a.csv", "# uncorrected\ntime [s],acc [g]\n0,0\n0.1,0.1\n0.2,-0.1\n0.3,0\n"),
    ],
)
def test_raw_data_causes_a_warning(tmp_path, name, text):
    path = write_file(tmp_path, text, name)
    with pytest.warns(rj.RecordWarning) as output:
        assert rj.read_motion(path).metadata["processing"].startswith("raw (")
    assert any(
        "is raw" in str(each.message) and "baseline_corrected(1)" in str(each.message) for each in output
    )
