"""The structures of native/run.h, field by field."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, Structure, c_double, c_int32, c_int64, c_void_p
from typing import Any

REAL, WHOLE = 0, 1
ACCESS, LINK, LOOP = 0, 1, 2
CONTINUE, STOP, DISCARDED = 0, 1, 2
OUT_OF_RANGE, WITHDRAWN = -1, -3
TYPES = (
    *(ctypes.c_double, ctypes.c_float, ctypes.c_int8, ctypes.c_uint8, ctypes.c_int16, ctypes.c_uint16),
    *(ctypes.c_int32, ctypes.c_uint32, ctypes.c_int64, ctypes.c_uint64, ctypes.c_bool),
)
JUDGE = ctypes.CFUNCTYPE(c_int32, c_void_p, c_int32, c_int32)


def _all(kind: Any, names: str) -> list[tuple[str, Any]]:
    """Fields of one type."""
    return [(name, kind) for name in names.split()]


class Access(Structure):
    """See `Access` in slaves/access.py."""

    _fields_ = [
        *_all(c_void_p, "function component references orders own values"),
        *_all(c_int32, "count fmi type bank sets"),
    ]


class Link(Structure):
    _fields_ = [
        *_all(c_void_p, "source target factor offset"),
        *_all(c_int32, "count bank"),
    ]


class Instruction(Structure):
    _fields_ = [("kind", c_int32), ("what", c_void_p)]


class Program(Structure):
    _fields_ = [("count", c_int32), ("instructions", POINTER(Instruction))]


class Member(Structure):
    _fields_ = [
        *_all(Program, "writers readers"),
        *_all(c_void_p, "derivative component trusted of by seed into"),
        *_all(c_int32, "fmi first count first_output outputs"),
    ]


class Loop(Structure):
    _fields_ = [
        ("members", POINTER(Member)),
        *_all(c_void_p, "u y g residual step before start scale unit seen slopes matrix shares"),
        *_all(c_void_p, "source targets sources factor offset rows flags counts"),
        *_all(c_int32, "member_count count outputs sweeps"),
    ]


class Telling(Structure):
    _fields_ = [
        *_all(c_void_p, "derivative component of by seed into from_ to factor"),
        *_all(c_int32, "fmi outputs count entries"),
    ]


class Foresight(Structure):
    _fields_ = [
        *_all(Program, "rates values"),
        ("tellings", POINTER(Telling)),
        *_all(c_void_p, "kinds signals"),
        *_all(c_void_p, "slopes k kc closed inverse f x w f0 x0 w0 q course felt push v stages rows"),
        *_all(c_int32, "telling_count n m wide broad through leads lag age usable"),
        *_all(c_double, "since last length"),
    ]


class Signal(Structure):
    _fields_ = [
        *_all(c_int32, "target source maker slope degree wanted order free tied foreseen known"),
        *_all(c_double, "factor offset scale"),
        *_all(c_double, "value slope0 value1 slope1 before chord bend"),
        *_all(c_double, "foretold weight lost returned"),
        ("c", c_double * 4),
    ]


class Part(Structure):
    _fields_ = [
        *_all(c_void_p, "component do_step get_state set_state state"),
        *_all(c_void_p, "event terminate early last flags clock"),
        *_all(c_double, "busy even"),
        *_all(c_int32, "fmi final factor first count revalued rough kept repeated"),
        *_all(c_void_p, "values derivatives"),
        *_all(Program, "writers reads newest tell"),
    ]


class Driver(Structure):
    _fields_ = [
        *_all(c_int64, "samples width row"),
        *_all(c_void_p, "time base slopes anchor"),
        *_all(c_void_p, "columns targets steady_columns steady held_columns held"),
        *_all(c_void_p, "factor offset steady_factor steady_offset coming middle signals"),
        *_all(c_int32, "count steady_count held_count"),
        ("when", c_double),
        ("writers", Program),
    ]


class Monitor(Structure):
    _fields_ = [
        *_all(c_void_p, "places spread moved seen step first last truth"),
        *_all(c_int32, "count rows room"),
        ("readers", Program),
    ]


class Recorder(Structure):
    _fields_ = [
        *_all(c_void_p, "places whole_places time reals wholes"),
        *_all(c_int32, "count whole_count filled room"),
    ]


class Pace(Structure):
    """See pace.py."""

    _fields_ = [
        *_all(c_double, "h smallest largest before uncut"),
        *_all(c_int32, "power repeats"),
    ]


class Run(Structure):
    _fields_ = [
        *_all(c_void_p, "real real_kept used slopes whole whole_kept"),
        *_all(c_int64, "reals wholes"),
        *_all(Program, "exchange tied"),
        ("parts", POINTER(Part)),
        ("signals", POINTER(Signal)),
        *_all(c_int32, "part_count signal_count"),
        ("driver", POINTER(Driver)),
        ("foresight", POINTER(Foresight)),
        ("monitor", Monitor),
        ("recorder", Recorder),
        *_all(c_void_p, "turns stepped"),
        *_all(c_int32, "degree sequential passes corrected"),
        ("tolerance", c_double),
        ("bonds", c_void_p),
        ("bond_count", c_int32),
        ("pace", POINTER(Pace)),
        ("adaptive", c_double),
        *_all(c_int32, "by_energy free keeps goes_back lost"),
        ("events", c_void_p),
        *_all(c_int64, "event_count event"),
        *_all(c_double, "start step t length older shorter shortest longest patience"),
        *_all(c_int64, "total done steps all_passes repeated"),
        ("pool", c_void_p),
        ("threads", c_int32),
        ("judge", JUDGE),
        ("reached", c_double),
    ]
