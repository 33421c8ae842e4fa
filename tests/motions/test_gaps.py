"""Gaps: masked arrays, missing values, fill values in arrays and files, waveform files with gaps."""

import warnings

import numpy as np
import pytest

import rockjax as rj

WAVE = np.sin(np.arange(400) / 20 * np.pi)
HOLE = (np.arange(400) > 149) & (np.arange(400) < 180)
COUNTS = np.round(1000 * WAVE).astype("int32")


@pytest.mark.parametrize("make", [rj.Motion, rj.Record])
@pytest.mark.parametrize(
    "samples",
    [
        np.ma.masked_array(np.where(HOLE, 999999, COUNTS), HOLE),
        np.ma.masked_array(WAVE, HOLE),
        np.ma.masked_invalid(np.where(HOLE, np.nan, WAVE)),
        np.where(HOLE, None, WAVE),
        np.where(HOLE, 999999, COUNTS),
        np.where(HOLE, -999, COUNTS),
        np.where(HOLE, -9999.0, WAVE),
        np.where(HOLE, -99.99 * 100, COUNTS),
        np.where(HOLE, np.iinfo("int32").min, COUNTS),
        np.where(HOLE, 9.969209968386869e36, WAVE).astype("float32"),
        [None if hole else float(y) for hole, y in zip(HOLE, WAVE, strict=True)],
        np.where(HOLE, np.nan, WAVE),
    ],
)
def test_samples_with_a_gap_are_refused(make, samples):
    with pytest.raises(ValueError, match=r"acceleration .*gap.*|.*samples 150 to 179") as error:
        make(samples, 0.01)
    assert "sample 150" in str(error.value) or "samples 150 to 179 of 400" in str(error.value)


def test_a_table_of_records_with_a_gap_is_refused():
    rest = (np.array([400, 400]), np.array([0.01, 0.01]), np.zeros(2), np.arange(2))
    for samples in (np.where(HOLE, np.nan, WAVE), np.where(HOLE, 1e20, WAVE)):
        with pytest.raises(ValueError, match=r"Records: acceleration .*samples 150 to 179 of 400"):
            rj.Records(np.stack([WAVE, samples]), *rest)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="Records: acceleration has a gap: no number"):
        rj.Records(np.ma.masked_array([WAVE, WAVE], [HOLE, HOLE]), *rest)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("make", [rj.Motion, rj.Record])
def test_lists_of_masked_arrays_and_values_that_are_no_numbers_are_refused(make):
    masked = np.ma.masked_array(np.where(HOLE, 999999, COUNTS), HOLE)
    for samples in ([masked, masked], [[1.0, None, 2.0]], (COUNTS, masked)):
        with pytest.raises(ValueError, match="has a gap: no number at sample"):
            make(samples, 0.01)
    for samples in (WAVE + 1j, np.arange(400).astype("datetime64[D]"), WAVE.astype(str)):
        with pytest.raises(ValueError, match="acceleration must be a number or an array of numbers"):
            make(samples, 0.01)


@pytest.mark.parametrize("value", [-12345, 65535, 8388608])
def test_the_longest_run_of_a_sentinel_is_named(value):
    samples = np.where(HOLE | (np.arange(400) == 7), value, COUNTS)
    with pytest.raises(ValueError, match=rf"has a gap: {value}, .* at samples 150 to 179 of 400"):
        rj.Motion(samples, 0.01)


def test_samples_that_only_look_like_sentinels_are_taken():
    slow = np.round(999 * np.sin(np.arange(4000) / 2000 * np.pi))  # stays at its peak for many samples
    peak = np.where(np.arange(400) == 7, 999.0, 900 * WAVE)
    for samples in (slow, peak, COUNTS, np.ma.masked_array(WAVE), 1e6 * WAVE, np.zeros(400)):
        np.testing.assert_array_equal(rj.Motion(samples, 0.01).acceleration, samples)
        np.testing.assert_array_equal(rj.Record(samples, 0.01).acceleration, samples)


@pytest.mark.parametrize("value", [-999, 999999, -9999.0, -99999.9])
def test_files_with_sentinels_are_refused(tmp_path, value):
    path = tmp_path / "a.csv"
    path.write_text("\n".join(f"{k / 100:.2f},{value if HOLE[k] else 100 * WAVE[k]:.6f}" for k in range(400)))
    with pytest.raises(ValueError, match=r"a\.csv has a gap: -?\d[\d.]*, .* at samples 150 to 179 of 400"):
        rj.read_motion(path, units="gal")
    np.save(tmp_path / "a.npy", np.where(HOLE, value, 100 * WAVE))
    with pytest.raises(ValueError, match=r"a\.npy has a gap"):
        rj.read_motion(tmp_path / "a.npy", units="gal", dt=0.01)


def waveform(samples, start=0.0, channel="HNE"):
    obspy = pytest.importorskip("obspy")
    header = {"network": "XX", "station": "ABCD", "channel": channel, "sampling_rate": 100.0}
    return obspy.Trace(samples, header | {"starttime": obspy.UTCDateTime(2020, 1, 1) + start})


def write_stream(path, *traces, **options):
    obspy = pytest.importorskip("obspy")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        obspy.Stream(list(traces)).write(str(path), format="MSEED", **options)
    return path


LONG_SAMPLES = np.sin(np.arange(4000) / 20 * np.pi)


def test_damaged_miniseed_is_reported(tmp_path):
    content = write_stream(tmp_path / "a.mseed", waveform(LONG_SAMPLES), reclen=512).read_bytes()
    half = len(content) // 2 // 512 * 512
    for damaged, cause in (
        (content[:half] + bytes(len(content) - half), "Not a SEED record"),
        (content + b"x" * 512, "Not a SEED record"),
        (content[: half + 100], "Last record only has 100 byte(s)"),
        (content[:-1], "its last 511 bytes are an incomplete data block"),
    ):
        (tmp_path / "a.mseed").write_bytes(damaged)
        with pytest.warns(rj.RecordWarning) as output:
            motion = rj.read_motion(tmp_path / "a.mseed", units="m/s2")
        expected = f"a.mseed: the file is damaged, and only {len(motion)} samples could be read: "
        assert any(expected in str(each.message) and cause in str(each.message) for each in output)
        assert "damaged" in motion.metadata
    (tmp_path / "a.mseed").write_bytes(content[:half] + bytes(512) + content[half + 512 :])
    with pytest.raises(ValueError, match=r"a\.mseed: XX\.ABCD\.\.HNE has 1 gaps, the first of \d+ samples"):
        rj.read_motion(tmp_path / "a.mseed", units="m/s2")
    (tmp_path / "a.mseed").write_bytes(content[:300])
    with pytest.raises(
        ValueError, match=r"a\.mseed: ObsPy cannot read the file: it is damaged, cut short or has"
    ):
        rj.read_motion(tmp_path / "a.mseed", units="m/s2")


def test_gaps_of_waveforms_are_named_as_gaps(tmp_path):
    path, up = tmp_path / "a.mseed", waveform(LONG_SAMPLES, channel="HNZ")
    gap = waveform(LONG_SAMPLES[:1000]), waveform(LONG_SAMPLES[1500:], 15)
    for traces, component, found in (
        (gap, None, "1 gaps, the first of 500 samples from 2020-01-01T00:00:09.99"),
        ((*gap, up), "HNE", "1 gaps, the first of 500 samples"),
        (
            (waveform(LONG_SAMPLES[:1000]), waveform(LONG_SAMPLES[900:], 9)),
            None,
            "1 overlaps, the first of 100 samples",
        ),
        (
            (
                waveform(LONG_SAMPLES[:900]),
                waveform(LONG_SAMPLES[1000:2000], 10),
                waveform(LONG_SAMPLES[2100:], 21),
            ),
            None,
            "2 gaps",
        ),
    ):
        with pytest.raises(ValueError) as error:
            rj.read_motion(write_stream(path, *traces), units="m/s2", component=component)
        assert f"{path}: XX.ABCD..HNE has {found}" in str(error.value)
    motion = rj.read_motion(write_stream(path, *gap, up), units="m/s2", component="vertical")
    np.testing.assert_array_equal(motion.acceleration, LONG_SAMPLES)
    motion = rj.read_motion(
        write_stream(path, waveform(LONG_SAMPLES[:1000]), waveform(LONG_SAMPLES[1000:], 10)), units="m/s2"
    )
    np.testing.assert_array_equal(motion.acceleration, LONG_SAMPLES)  # pieces without a gap
    filled = np.where((np.arange(4000) > 999) & (np.arange(4000) < 1500), 999999, 1000 * LONG_SAMPLES)
    with pytest.raises(ValueError, match=r"has a gap: 999999, .*, at samples 1000 to 1499 of 4000"):
        rj.read_motion(write_stream(path, waveform(filled.astype("int32"))), units="m/s2")


@pytest.mark.parametrize("dt", [0.01, 0.0078125, 1 / 300, 0.0123456])
def test_intervals_of_sac_files(tmp_path, dt):
    """SAC files store the interval in float32; a rounded interval is no damage."""
    trace = waveform(LONG_SAMPLES)
    trace.stats.delta = dt
    trace.write(str(tmp_path / "a.sac"), format="SAC")
    motion = rj.read_motion(tmp_path / "a.sac", units="m/s2")
    assert motion.dt == pytest.approx(dt, rel=1e-7)
    assert motion.dt == dt or dt == 1 / 300
    assert "damaged" not in motion.metadata


def test_counts_of_waveforms_are_raw(tmp_path):
    path = write_stream(tmp_path / "a.mseed", waveform(np.round(1000 * LONG_SAMPLES).astype("int32")))
    with pytest.warns(rj.RecordWarning, match=r"a\.mseed: the motion is raw \(whole numbers\)"):
        rj.read_motion(path, units="mm/s2")
