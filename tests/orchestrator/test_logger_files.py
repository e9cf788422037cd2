"""MF4 and TDMS files as loggers write them, read as recordings and scenarios; other formats by name."""

import gc
import gzip
import io
import signal
import struct

import numpy as np
import pytest
from asammdf import MDF, Signal
from kit.any_fmu.description import packed
from kit.mistakes import problem
from kit.needs import needs
from nptdms import ChannelObject, TdmsWriter

from orchestrator import read_recording, run
from orchestrator.data import logger_files
from orchestrator.data.table import read_columns
from orchestrator.data.trace import read_trace

FAST = np.arange(400) / 200
SLOW = 0.003 + np.arange(99) / 50  # 3 ms late, as messages of another cycle are
DESCRIPTION = '[signals."boom_stick.boom_head_pressure"]\ncolumn = "P1"\n[signals."manipulator.boom_angle"]\n'


def line(time):
    """A motion that linear interpolation keeps exactly."""
    return 20 + 8 * time


@pytest.fixture
def mf4(tmp_path):
    """A CAN log: pressures at 200 Hz and a voltage of the same name twice, angles at 50 Hz, 3 ms late."""
    with MDF(version="4.10") as log:
        pressure = Signal(np.round(100 + 9 * np.sin(FAST), 2), FAST, name="P1", unit="bar")
        log.append([pressure, Signal(FAST, FAST, name="U", unit="V")], acq_name="Drive")
        angle = Signal(line(SLOW), SLOW, name="angle", unit="deg")
        log.append([angle, Signal(SLOW, SLOW, name="U", unit="V")])
        log.save(tmp_path / "can.mf4")
    return tmp_path / "can.mf4"


@pytest.fixture
def tdms(tmp_path):
    """A DAQ log: the same signals as waveforms, the slow one starts 3 ms later."""
    fast = {"wf_increment": 1 / 200, "wf_start_offset": 0.0, "unit_string": "bar"}
    fast["wf_start_time"] = np.datetime64("2026-03-02T08:15:00.000", "us")
    slow = fast | {"wf_increment": 1 / 50, "unit_string": "deg"}
    slow["wf_start_time"] = np.datetime64("2026-03-02T08:15:00.003", "us")
    with TdmsWriter(tmp_path / "daq.tdms") as log:
        pressure = ChannelObject("Drive", "P1", np.round(100 + 9 * np.sin(FAST), 2), properties=fast)
        log.write_segment([pressure, ChannelObject("Pose", "angle", line(SLOW), properties=slow)])
    return tmp_path / "daq.tdms"


@pytest.mark.parametrize("kind", ["mf4", "tdms"])
def test_groups_of_several_rates_are_one_recording(kind, request):
    """Names, units and times of the file; each slow sample is once, at the nearest time of the fast ones."""
    file = request.getfixturevalue(kind)
    text = DESCRIPTION + 'column = "angle"\n'
    file.with_suffix(".toml").write_text(text, encoding="utf-8")
    made = read_recording(file)
    np.testing.assert_allclose(made.time, FAST, atol=1e-12)  # rounding of a product
    pressure = 1e5 * np.round(100 + 9 * np.sin(FAST), 2)
    np.testing.assert_allclose(made["boom_stick.boom_head_pressure"], pressure, rtol=1e-12)  # rounding
    angle = made["manipulator.boom_angle"]
    # 3 ms after each fourth sample the next one, 2 ms later, is nearer
    assert np.flatnonzero(np.isfinite(angle)).tolist() == list(range(1, 393, 4))
    np.testing.assert_allclose(angle[1:393:4], np.radians(line(FAST[1:393:4])), rtol=1e-9)  # a line, rounding


def test_a_name_of_several_groups_has_that_of_its_group(mf4):
    """A name alone is refused, with the names that there are."""
    assert [*read_columns(mf4, None).values] == ["time", "P1", "Drive.U", "angle", "group 2.U"]
    assert read_columns(mf4, {"Drive.U"}).values["Drive.U"].tolist() == FAST.tolist()
    told = problem(lambda: read_columns(mf4, {"U"}))
    assert told.startswith(f"{mf4}: expected a column 'U', got time, P1, Drive.U, angle, group 2.U")


def test_a_unit_of_the_description_holds(mf4):
    """It wins against that of the file; a column without any is refused."""
    text = DESCRIPTION + 'column = "angle"\nunit = "rad"\n'
    mf4.with_suffix(".toml").write_text(text, encoding="utf-8")
    assert np.nanmax(read_recording(mf4)["manipulator.boom_angle"]) == pytest.approx(line(1.963), rel=0.01)
    with MDF(version="4.10") as log:
        log.append([Signal(FAST, FAST, name="P1"), Signal(FAST, FAST, name="angle", unit="deg")])
        log.save(mf4, overwrite=True)
    place = f'{mf4.with_suffix(".toml")}: signals."boom_stick.boom_head_pressure"'
    assert problem(lambda: read_recording(mf4)) == f"{place}: unit: expected a text, got nothing"


def test_enumerations_are_numbers_and_invalid_samples_are_gaps(tmp_path):
    """An enumeration has its raw values; samples that the logger marked as invalid are left out."""
    values = {"val_0": 0, "text_0": b"off", "val_1": 1, "text_1": b"on"}
    invalid = np.isin(np.arange(400), [7, 300])
    with MDF(version="4.10") as log:
        mode = Signal((FAST > 1).astype("u1"), FAST, name="mode", conversion=values)
        log.append([Signal(FAST, FAST, name="x", invalidation_bits=invalid), mode])
        log.save(tmp_path / "a.mf4")
    found = read_columns(tmp_path / "a.mf4", {"mode", "x"}).values
    assert found["mode"].tolist() == (FAST > 1).astype(float).tolist()
    assert np.flatnonzero(np.isnan(found["x"])).tolist() == [7, 300]


def test_times_of_a_tdms_file_may_be_a_channel(tmp_path):
    """Dates and times of day begin at 0; numbers are in their unit; the unit is in the properties."""
    dates = np.datetime64("2026-03-02T08:15:00", "us") + np.round(1e6 * FAST).astype("timedelta64[us]")
    pressure = {"unit_string": "bar"}
    for name, times, about in (("Datum", dates, {}), ("Zeit", 1e3 * FAST + 4000, {"unit_string": "ms"})):
        with TdmsWriter(tmp_path / "a.tdms") as log:
            clock = ChannelObject("G", name, times, properties=about)
            log.write_segment([clock, ChannelObject("G", "P1", FAST, properties=pressure)])
        found = read_columns(tmp_path / "a.tdms", {"time", "P1"})
        # rounding of microseconds
        np.testing.assert_allclose(found.values["time"], FAST + (4 if about else 0), atol=1e-9)
        assert found.units == {"time": "s", "P1": "bar"}
    for count in (300, 500):  # other than the 400 times of a file that is complete
        with TdmsWriter(tmp_path / "b.tdms") as log:
            log.write_segment([ChannelObject("G", "Zeit", FAST), ChannelObject("G", "P1", np.arange(count))])
        expected = f"{tmp_path / 'b.tdms'}: expected columns of one length, got 400 times, P1 {count}"
        assert refusal(tmp_path / "b.tdms") == expected


def test_a_log_drives_a_run(built, tmp_path):
    """As the scenario: the command is that of the file."""
    with MDF(version="4.10") as log:
        log.append([Signal(np.minimum(FAST, 1), FAST, name="boom_stick.boom_command", unit="V")])
        log.save(tmp_path / "up.mf4")
    assert read_trace(tmp_path / "up.mf4")["boom_command"].tolist() == np.minimum(FAST, 1).tolist()
    result = run(built / "harvester.ssp", tmp_path / "up.mf4", stop=0.1, record=["boom_stick.boom_command"])
    np.testing.assert_allclose(result["boom_command"], result.time, atol=1e-12)  # a ramp, rounding


EXCEL, ZIP = (packed(io.BytesIO(), {n: "a"}).getvalue() for n in ("[Content_Types].xml", "log.csv"))
DIADEM = "a header of DIAdem: export its channels"
FOREIGN = {
    "log.mcap": (b"\x89MCAP0\r\n\x01" + bytes(90), "MCAP: export its topics as CSV"),
    "log.bag": (b"#ROSBAG V2.0\n" + bytes(90), "a ROS bag: export"),
    "log.blf": (b"LOGG\x90\0\0\0" + bytes(136), "BLF or ASC (Vector): decode it with the DBC file"),
    "log.asc": (
        b"date Tue Nov 24 10:11:12.000 am 2026\r\nbase hex  timestamps absolute\r\n0.01 1 CF00400x Rx d\r\n",
        "BLF or ASC (Vector): decode it with the DBC file",
    ),
    "log.log": (b"(1790000000.000100) vcan0 0CF00400#F07D7D80\n", "candump: decode it with the DBC file"),
    "log.txt": (b"  can1  18FEF100   [8]  00 11 22 33 44 55 66 77\n", "candump: decode it"),
    "log.trc": (b";$FILEVERSION=1.1\r\n", "a PCAN trace: decode it"),
    "log.dat": (b"MDF     3.30    TGT 15.0" + bytes(200), "MDF 3: save it as MDF 4, such as by asammdf"),
    "log.xlsx": (EXCEL, "Excel: save the sheet as CSV"),
    "log.xls": (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(90), "Excel: save the sheet as CSV"),
    "plot.csv": (b"\x89PNG\r\n\x1a\n" + bytes(90), "a picture or a PDF: export its values as CSV"),
    "log.tdm": (b'<?xml version="1.0"?>\n<usi:tdm xmlns:usi="x" version="1.0">', DIADEM),
    "dia.dat": (b"DIAEXTENDED  {@:ENGLISH\n\n#BEGINGLOBALHEADER\n", DIADEM),
    "log.zip": (ZIP, "an archive: unpack it"),
    "log.csv.gz": (gzip.compress(b"time,x\n0,1\n1,2\n"), "an archive: unpack it"),
    "log.csv": (b"PAR1\x15\x04" + bytes(90), "Parquet: name it .parquet"),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_another_format_is_refused_by_name(name, tmp_path):
    """In one line with the way out, whatever the file is called; as a scenario, too."""
    data, told = FOREIGN[name]
    (tmp_path / name).write_bytes(data)
    for read in (lambda: read_columns(tmp_path / name, {"x"}), lambda: read_trace(tmp_path / name)):
        expected = f"{tmp_path / name}: expected a text (CSV), MF4 or TDMS file, got {told}"
        assert problem(read).startswith(expected)


@pytest.mark.parametrize("text", ["LOGG,PAR1\n1,2\n3,4\n", "date Mon,can0\n1,2\n2,3\n", "PK,BZh\n1,2\n5,6\n"])
def test_a_text_that_begins_like_another_format_is_a_text(text, tmp_path):
    """The names of columns are free."""
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    assert len(read_columns(tmp_path / "a.csv", None).values) == 2


def refusal(file):
    return problem(lambda: read_columns(file, None))


# asammdf leaves its temporary file open
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_damaged_mf4_file_is_one_line(mf4, capfd):
    """Cut off anywhere, or overwritten: no traceback of the library."""
    data = mf4.read_bytes()
    for part in (*(data[: len(data) * k // 8] for k in range(1, 6)), data[:64] + bytes(300)):
        mf4.write_bytes(part)
        assert refusal(mf4).startswith(f"{mf4}: expected an MF4 file, got a damaged one (")
    gc.collect()
    assert capfd.readouterr() == ("", "")


def block(name, links, data):
    """A block of MDF 4 (ASAM MDF 4.1, section 5): its links, then its data."""
    size = 24 + 8 * len(links) + len(data)
    return struct.pack(f"<4sIQQ{len(links)}q", name, 0, size, len(links), *links) + data


HD, DG, CG = 64, 168, 232  # addresses of a header, a group of data, and one of channels
LOOPS = {"HD": (HD, DG, 0, 0), "DG": (DG, DG, CG, 0), "CG": (DG, 0, CG, CG)}


@needs("POSIX", "Windows has no limit of time within a process")
# asammdf leaves its temporary file open
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("name", LOOPS)
def test_blocks_that_follow_themselves_end_in_one_line(name, tmp_path, monkeypatch):
    """A header as the first group, a group of data or one of channels whose next one is itself."""
    monkeypatch.setattr(logger_files, "PATIENCE", 0.3)
    first, next_data, channels, next_channels = LOOPS[name]
    data = struct.pack("<8s8s8s4xH34x", b"MDF     ", b"4.10    ", b"test    ", 410)
    data += block(b"##HD", [first, 0, 0, 0, 0, 0], bytes(32))
    data += block(b"##DG", [next_data, channels, 0, 0], bytes(8))
    data += block(b"##CG", [next_channels, 0, 0, 0, 0, 0], bytes(32))
    (tmp_path / "a.mf4").write_bytes(data)
    told = refusal(tmp_path / "a.mf4")
    damaged = f"{tmp_path / 'a.mf4'}: expected an MF4 file, got a damaged one (TimeoutError: not done within "
    assert told.startswith(damaged)
    gc.collect()
    assert signal.getitimer(signal.ITIMER_PROF) == (0, 0)


def test_a_tdms_file_that_is_cut_off_is_read_up_to_there(tdms, capfd):
    """A logger that lost power writes such files. One without any whole block is refused."""
    data = tdms.read_bytes()
    tdms.write_bytes(data[:-300])
    values = read_columns(tdms, None).values
    assert capfd.readouterr().err == f"{tdms}: the end is cut off; read up to there\n"
    assert values["P1"].tolist() == np.round(100 + 9 * np.sin(FAST), 2).tolist()
    assert 50 < np.isfinite(values["angle"]).sum() < 99
    tdms.write_bytes(data[:40])
    assert refusal(tdms) == f"{tdms}: expected two or more rows of numbers, got none"
    tdms.write_bytes(data[:12] + bytes(200))
    assert refusal(tdms).startswith(f"{tdms}: expected a TDMS file, got a damaged one (")


@pytest.mark.parametrize("lost", [8, 1000, 1600, 3999])
def test_the_rows_that_all_channels_of_a_group_have_are_read(tmp_path, lost, capfd):
    """A group with a channel of times whose last segment of 250 rows lost bytes of its last channel."""
    with TdmsWriter(tmp_path / "a.tdms") as log:
        for half in (FAST[:150], FAST[150:]):
            group = {"time": half, "a": line(half), "b": -line(half)}
            log.write_segment([ChannelObject("g", name, values) for name, values in group.items()])
    data = (tmp_path / "a.tdms").read_bytes()
    (tmp_path / "a.tdms").write_bytes(data[:-lost])
    trace, rows = read_trace(tmp_path / "a.tdms"), 400 - (min(lost, 2000) + 7) // 8
    assert "the end is cut off" in capfd.readouterr().err
    whole = rows if lost <= 2000 else 150
    np.testing.assert_array_equal(trace.time, FAST[:whole])
    np.testing.assert_array_equal(trace["b"], -line(FAST[:whole]))


OTHER_KINDS = {
    "a.json": ('[{"ts": 1700000000000, "values": {"P1": 80.1}}]', "got JSON: write its signals to CSV"),
    "b.json": ('{"ts": [1, 2], "P1": [3, 4]}', "got JSON"),
    "a.txt": (
        "crane,unit=a p=80.0,q=1 1700000000000000000\n",
        "got Influx line protocol: pivot it to one column",
    ),
    "b.txt": ("crane p=80.0 17000\ncrane p=81.0 17001\n", "got Influx line protocol"),
    "a.csv": (
        "t,topic,data\n0,/p,1\n0,/q,2\n1,/p,1\n1,/q,2\n",
        "column 'topic': expected a column for each signal",
    ),
    "b.csv": (
        "time,_value,_field\n0,1,p\n1,1,q\n2,1,p\n3,2,q\n",
        "got a long table with names such as 'p': pivot it",
    ),
    "c.csv": (
        'action,timestamp\n"[1.0, 2.0]",0\n"[1.0, 3.0]",0.1\n',
        "column 'action': expected numbers, got lists",
    ),
}


@pytest.mark.parametrize("name", OTHER_KINDS)
def test_messages_of_telemetry_are_told_by_their_kind(name, tmp_path):
    """In one line with the way out."""
    text, told = OTHER_KINDS[name]
    (tmp_path / name).write_text(text, "utf-8")
    assert told in problem(lambda: read_trace(tmp_path / name))


def test_a_signal_beside_its_state_is_no_long_table(tmp_path):
    """Nor are texts in a column of another name."""
    (tmp_path / "a.csv").write_text("time,p,mode\n0,1,on\n1,2,off\n2,3,on\n", "utf-8")
    assert problem(lambda: read_trace(tmp_path / "a.csv")).endswith(
        "column 'mode': expected a number, got 'on'"
    )


def test_frames_of_a_bus_need_their_dbc(tmp_path):
    """A log of raw frames is refused with the way out."""
    frames = np.rec.fromarrays(np.zeros((2, 400)), names=["CAN_DataFrame.ID", "CAN_DataFrame.DLC"])
    with MDF(version="4.10") as log:
        log.append([Signal(frames, FAST, name="CAN_DataFrame")])
        log.save(tmp_path / "raw.mf4")
    told = problem(lambda: read_columns(tmp_path / "raw.mf4", {"P1"}))
    assert "expected signals, got frames of a CAN bus: decode them with the DBC file" in told
