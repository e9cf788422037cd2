"""A running FMU as a component of a system: get and set variables; for Co-Simulation steps and rollback."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from orchestrator.base.errors import AtEvent, Discarded, Ended, Problem
from orchestrator.base.files import Location
from orchestrator.fmi.calls import (
    TEXTS,
    Access,
    Buffer,
    Call,
    DirectionalDerivative,
    StepCalls,
    address,
    compatible_buffer,
    from_ctypes,
    set_starts,
    to_ctypes,
)
from orchestrator.fmi.clocks import ClockCalls
from orchestrator.fmi.description import FmuVariable, Value
from orchestrator.fmi.instance import MAX_VALUES, AfterCall, Chatter, FmuInstance, resources_location, settle
from orchestrator.fmi.interface import MODEL_EXCHANGE, FmuInterface
from orchestrator.fmi.library import load_library
from orchestrator.fmi.messages import DISCARD, ERROR, FATAL, WARNING, Log, status_label

UNUSED = ("sources/", "documentation/")  # by a running FMU
_LENGTH = (ctypes.CDLL(None) if os.name == "posix" else ctypes.cdll.msvcrt).strnlen
_LENGTH.argtypes, _LENGTH.restype = (ctypes.c_void_p, ctypes.c_size_t), ctypes.c_size_t
LOG_CATEGORIES = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")


class RunningFmu:
    """An FMU from instantiation to termination, with bound calls for its variables.

    event_mode   it has event mode between steps: variables that are not continuous are set there
    in_events    it is in event mode
    next_event   time of its next time event, as far as it has event mode between steps [s]
    notes        on its instantiation
    clocks       the calls of its clocks
    """

    event_mode = in_events = _asks = False
    next_event = float("inf")
    notes: tuple[str, ...] = ()

    def __init__(self, name: str, interface: FmuInterface, fmu: Location, after: AfterCall = None) -> None:
        """`after`: see `FmuInstance`."""
        self.name, self.interface, self.log = name, interface, Log(name, interface.marks)
        self._label, self._stepping, self._after = f"{name} ({fmu})", False, after
        self._inside = Chatter(float("nan"))  # of events inside of steps
        self._cleanup = ExitStack()
        try:
            self._open(fmu)
        except BaseException:
            self.close()
            raise

    def _open(self, fmu: Location) -> None:
        face = self.interface
        folder = self._cleanup.enter_context(fmu.unpacked(UNUSED))
        library = load_library(folder, face.identifier, face.model.major, self._label)
        self.fmu = FmuInstance(library, self.log, face.kind == MODEL_EXCHANGE, None, self._label, self._after)
        self.clocks = ClockCalls(self.fmu, self.name)
        self._cleanup.callback(self._unless_fatal, library.close)
        self._cleanup.callback(self.fmu.free)
        resources = resources_location(folder, face.model.major)
        made = partial(self.fmu.instantiate, face.model.token, resources)
        modes = [face.event_mode] if face.has_clocks else [face.event_mode, False]
        attempts = ((mode, verbose) for mode in dict.fromkeys(modes) for verbose in (False, True))
        for mode, verbose in attempts:  # an FMU logs the reason in the second attempt, with debug logging
            if made(verbose=verbose, events=mode, early=mode and face.early_return):
                break
        else:
            raise Problem(f"{self._label}: the FMU could not be instantiated{self.log.quoted_messages()}")
        if mode != face.event_mode:
            self.event_mode, self.interface = False, replace(face, event_mode=False)
            refused = "declares event mode and refuses to be instantiated with it: its events are inside of"
            self.notes = (f"{self.name}: the FMU {refused} steps{self.log.quoted_messages(1)}",)
            self.log.messages.clear()
        categories = [c.encode() for c in LOG_CATEGORIES if c in face.model.categories]
        if categories:
            count, array = len(categories), (ctypes.c_char_p * len(categories))(*categories)
            with suppress(Problem):  # an FMU that cannot select log categories can still run
                self.fmu.status("SetDebugLogging", self.fmu.flag(True), ctypes.c_size_t(count), array)

    def _unless_fatal(self, call: Call) -> None:
        """Execute a call, except after a fatal error, when FMI forbids further calls."""
        if self.fmu.worst < FATAL:
            call()

    def setup(self, start: float, stop: float, tolerance: float | None) -> None:
        """Announce the experiment; times in [s], an infinite stop time is none."""
        self.fmu.setup(start, stop if np.isfinite(stop) else None, tolerance)

    def enter(self) -> None:
        """Enter initialisation mode."""
        self.fmu.enter()

    def exit(self) -> None:
        """Leave initialisation mode and enter step mode."""
        self.fmu.leave()
        self._stepping = True

    def close(self) -> None:
        """Terminate and free the instance, unload the library. May be repeated."""
        if self._stepping and self.fmu.worst < ERROR:
            self._stepping = False
            with suppress(Problem):
                self.fmu.call("Terminate")
        self._cleanup.close()

    def saved(self) -> dict[str, Any]:
        """Its serialised state and what this project adds, as arrays, for another process."""
        state = self.fmu.save()
        data = self.fmu.serialize(state)
        self.fmu.free_state(state)
        return {"state": np.frombuffer(data, np.uint8), "next_event": self.next_event}

    def resume(self, saved: Mapping[str, Any]) -> None:
        """Go on from a state of `saved`."""
        state = self.fmu.deserialize(bytes(saved["state"]))
        self.fmu.restore(state)
        self.fmu.free_state(state)
        self.next_event = float(saved["next_event"])

    def after_rollback(self) -> None:
        """Discard the messages and the status of a step that will be repeated from a saved state."""
        self.log.discard_repeated()
        if self.fmu.worst < FATAL:
            self.fmu.worst = min(self.fmu.worst, WARNING)

    def free_state(self, state: Any) -> None:
        """Free a saved FMU state; errors are ignored if the FMU has failed before."""
        with suppress(Problem) if self.fmu.worst >= ERROR else nullcontext():
            self._unless_fatal(partial(self.fmu.free_state, state))

    # ---- several variables of one type

    def _wholes(self, variables: Sequence[str]) -> tuple[list[FmuVariable], Sequence[str]]:
        """The arrays and scalars of some variables, and all their elements, as FMI functions take them."""
        declared = [self.interface.variables[v] for v in variables]
        if not any(v.array for v in declared):
            return declared, [*variables]
        wholes = [*dict.fromkeys(v.array or v for v in declared)]
        return wholes, [name for whole in wholes for name in whole.elements]

    def _access(
        self, function: str, variables: Sequence[str], values: Buffer, type_: str, orders: Sequence[int] = ()
    ) -> Access | Call:
        """A bound call of a function that gets or sets variables of an FMI type."""
        wholes, elements = self._wholes(variables)
        count, references = len(variables), [whole.reference for whole in wholes]
        if elements != [*variables]:
            return self._part(function, variables, elements, values, type_)
        orders = orders[: len(references)]
        fmu_values = compatible_buffer(values, count, self.fmu.types[type_])
        order_argument = [(ctypes.c_int * len(orders))(*orders)] if orders else []
        value_arguments = self.fmu.values(address(fmu_values), count)
        arguments = *self.fmu.references(references), *order_argument, *value_arguments
        return Access(
            call=self.fmu.bound(function, *arguments, variables=variables),
            references=np.array(references, np.uint32),
            orders=np.array(orders, np.int32) if orders else None,
            fmu_values=fmu_values,
            values=values[:count],
            sets=function.startswith("Set"),
            names=variables,
        )

    def _part(
        self, function: str, variables: Sequence[str], elements: Sequence[str], values: Buffer, type_: str
    ) -> Call:
        """A call for a part of the elements of arrays, which an FMU gets and sets whole.

        To set some, all are read before, as an FMU allows from its initialisation mode on.
        """
        index = {name: k for k, name in enumerate(elements)}
        part, buffer = np.array([index[v] for v in variables]), np.zeros(len(elements), values.dtype)
        orders = [1] * len(elements) if "Derivatives" in function else []
        access = self._access(function, elements, buffer, type_, orders)

        def read() -> None:
            access()
            values[: len(part)] = buffer[part]

        def write() -> None:
            for whole in self._wholes(variables)[0]:
                first = index[whole.elements[0]]
                buffer[first : first + whole.size] = self._values(whole)
            buffer[part] = values[: len(part)]
            access()

        return read if function.startswith("Get") else write

    def _hint(self, variables: Sequence[str]) -> str:
        """Why outputs are read after inputs are set without a step, which FMI 2.0 does not allow."""
        face = self.interface
        late = [v for v in variables if face.variables[v].causality == "output" and face.direct_inputs(v)]
        if face.kind == MODEL_EXCHANGE or face.model.major != 2 or not late:
            return ""
        y = min(late, key=lambda v: face.dependencies.get(v) is not None)
        reason = f"declares that {y} depends on {', '.join(sorted(face.direct_inputs(y)))}"
        reason = reason if face.dependencies.get(y) is not None else f"declares no dependencies of {y}"
        return f" (read after inputs were set, because the FMU {reason}: FMI 2.0, 4.2.4)"

    def reader(self, variables: Sequence[str], into: Buffer) -> Access | Call:
        """A call that gets the variables and stores them in `into`, shape (n,)."""
        type_ = self.interface.variables[variables[0]].function_type
        access = self._access(f"Get{type_}", variables, into, type_)
        if isinstance(access, Access):
            access.call.check_status = partial(access.call.check_status, hint=self._hint(variables))
        return access

    def writer(self, variables: Sequence[str], values: Buffer) -> Call:
        """A call that sets the variables to `values`, shape (n,).

        Outside of event mode it sets those that are not continuous only if they change, by an event of this
        FMU alone.
        """
        type_ = self.interface.variables[variables[0]].function_type
        set_plainly = partial(self._access, f"Set{type_}", type_=type_)
        continuous = np.array([self.interface.variables[v].is_continuous for v in variables])
        if continuous.all() or not self.event_mode:
            return set_plainly(variables, values)
        moving, held = np.flatnonzero(continuous), np.flatnonzero(~continuous)
        buffers = [np.zeros(len(part), values.dtype) for part in (moving, held, held)]
        names = [[variables[i] for i in part.tolist()] for part in (moving, held)]
        write_moving = set_plainly(names[0], buffers[0]) if len(moving) else None
        write, read = set_plainly(names[1], buffers[1]), self.reader(names[1], buffers[2])

        def set_all() -> None:
            buffers[0][:], buffers[1][:] = values[moving], values[held]
            if write_moving:
                write_moving()
            if self.in_events or not self._stepping:
                write()
                return
            read()
            if not np.array_equal(buffers[1], buffers[2]):
                self.event_alone(write)

        return set_all

    def output_derivative_reader(self, variables: Sequence[str], into: Buffer) -> Access | Call:
        """A call that gets the first time derivatives of outputs and stores them in `into`, shape (n,)."""
        return self._access("GetOutputDerivatives", variables, into, self._real, [1] * len(variables))

    def input_derivative_writer(
        self, variables: Sequence[str], derivatives: Buffer, orders: Sequence[int] = ()
    ) -> Call:
        """A call that sets time derivatives of inputs for the next step to `derivatives`, shape (n,).

        orders   order of each derivative; default: all 1

        Without canInterpolateInputs, as always in FMI 3.0, the call sets the rate inputs, which are the time
        derivatives.
        """
        orders = orders or [1] * len(variables)
        if self.interface.can_interpolate_inputs:
            return self._access("SetRealInputDerivatives", variables, derivatives, self._real, orders)
        for v, order in zip(variables, orders, strict=True):
            if v not in self.interface.ramp_inputs or order != 1:
                text = f"the FMU accepts no derivative of order {order} of this input"
                raise Problem(f"{self.name}: {v}: {text}")
        return self.writer([self.interface.rate_inputs[v] for v in variables], derivatives)

    @property
    def _real(self) -> str:
        return "Real" if self.interface.model.major == 2 else "Float64"

    def directional_derivative(
        self, unknowns: Sequence[str], knowns: Sequence[str], seed: Buffer, into: Buffer
    ) -> DirectionalDerivative | Call:
        """A call that computes the change of the unknowns when the knowns change along `seed`.

        seed, into   shapes (len(knowns),) and (len(unknowns),)
        """
        (of_unknowns, all_unknowns), (of_knowns, all_knowns) = self._wholes(unknowns), self._wholes(knowns)
        if all_unknowns != [*unknowns] or all_knowns != [*knowns]:  # other elements do not change
            whole_seed, result = np.zeros(len(all_knowns)), np.zeros(len(all_unknowns))
            inner = self.directional_derivative(all_unknowns, all_knowns, whole_seed, result)
            to, of = [all_knowns.index(v) for v in knowns], [all_unknowns.index(v) for v in unknowns]

            def derive() -> None:
                whole_seed[to] = seed
                inner()
                into[:] = result[of]

            return derive
        unknown_references = [v.reference for v in of_unknowns]
        known_references = [v.reference for v in of_knowns]
        arguments = [*self.fmu.references(unknown_references), *self.fmu.references(known_references)]
        for values, count in ((seed, len(knowns)), (into, len(unknowns))):
            buffer = compatible_buffer(values, count, ctypes.c_double)
            arguments += self.fmu.values(address(buffer), count)
        return DirectionalDerivative(
            call=self.fmu.bound("GetDirectionalDerivative", *arguments, variables=unknowns),
            unknowns=np.array(unknown_references, np.uint32),
            knowns=np.array(known_references, np.uint32),
        )

    # ---- single variables

    def get(self, variable: str) -> Value:
        """Get one variable of any type."""
        declared = self.interface.variables[variable]
        return self._values(declared.array or declared)[declared.position]

    def reads(self, variable: FmuVariable) -> bool:
        """Has its library a function that gets a variable?"""
        return self.fmu.library.has(f"Get{variable.function_type}")

    def _values(self, whole: FmuVariable) -> list[Value]:
        """The values of an array or a scalar."""
        cells = (self.fmu.types[whole.function_type] * whole.size)()
        if whole.kind not in TEXTS:
            self._call_whole("Get", whole, cells)
            return [from_ctypes(whole, cell) for cell in cells]
        sizes = (ctypes.c_size_t * whole.size)()
        if whole.kind == "Binary":
            references = self.fmu.references([whole.reference])
            self.fmu.call("GetBinary", *references, sizes, *self.fmu.values(cells, whole.size))
        else:
            self._call_whole("Get", whole, cells)
        pointers = (ctypes.c_void_p * whole.size).from_buffer(cells)
        if whole.kind == "String":
            sizes[:] = [_LENGTH(p, MAX_VALUES + 1) if p else 0 for p in pointers]
        self.fmu.check_size(f"the value of {whole.name}", sum(sizes))
        found = [ctypes.string_at(p, n) if p else b"" for p, n in zip(pointers, sizes, strict=True)]
        return [data.hex() if whole.kind == "Binary" else data.decode(errors="replace") for data in found]

    def set(self, variable: str, value: Any) -> None:
        """Set one variable of any type, or an array by the values of all its elements.

        If it is not continuous, in event mode if there is one.
        """
        declared = self.interface.arrays.get(variable) or self.interface.variables[variable]
        if declared.causality == "structuralParameter":
            self.configure({variable: value})
            return
        if self.event_mode and self._stepping and not (self.in_events or declared.is_continuous):
            if self.get(variable) != value:
                self.event_alone(partial(self._set, declared, value))
            return
        self._set(declared, value)

    def _set(self, declared: FmuVariable, value: Any) -> None:
        whole, values = declared.array or declared, [value]
        if declared.array:
            values = [*self._values(whole)]
            values[declared.position] = value
        elif declared.shape:
            values = [*value]
        ctype = self.fmu.types[whole.function_type]
        if whole.kind == "Binary":
            data = [bytes.fromhex(str(v)) for v in values]
            sizes = (ctypes.c_size_t * len(data))(*map(len, data))
            references, cells = self.fmu.references([whole.reference]), (ctype * len(data))(*data)
            self.fmu.call("SetBinary", *references, sizes, *self.fmu.values(cells, len(data)))
            return
        cells = (ctype * len(values))(*(to_ctypes(declared, ctype, v) for v in values))
        self._call_whole("Set", whole, cells)

    def configure(self, sizes: Mapping[str, Any]) -> None:
        """Set structural parameters."""
        self.fmu.call("EnterConfigurationMode")
        for name, value in sizes.items():
            self._set(self.interface.variables[name], value)
        self.fmu.call("ExitConfigurationMode")

    # ---- event mode

    def asks_for_event(self) -> bool:
        """Has it asked for event mode at the end of a step since the last call?"""
        asks, self._asks = self._asks, False
        return asks

    def enter_events(self) -> None:
        """Enter event mode, at the end of a step; after its initialisation an FMU may be there."""
        if not self.in_events:
            self._enter_events()
        self.in_events = True

    @cached_property
    def _enter_events(self) -> Call:
        return self.fmu.bound("EnterEventMode")

    @cached_property
    def _enter_steps(self) -> Call:
        return self.fmu.bound("EnterStepMode")

    def update(self) -> tuple[bool, bool, float]:
        """One event iteration, see `FmuInstance.update_discrete_states`."""
        result = self.fmu.update_discrete_states()
        self.next_event = result[2]
        return result

    def leave_events(self) -> None:
        """Leave event mode, ready for a step."""
        self._enter_steps()
        self.in_events = False

    def event_alone(self, write: Call) -> None:
        """An event of this FMU alone, in which variables are set."""
        self.enter_events()
        write()
        ended, _ = settle(self.name, {self.name: self.update})
        self.leave_events()
        if ended:
            raise self.ended_at(self.log.time)

    def event_inside(self, t: float) -> None:
        """An event of this FMU alone at a time [s] inside of a step, which others cannot repeat."""
        begin, end = self.log.clock[1:]
        self._inside.check([self.name], t, end - begin)
        self.log.time = t
        self.event_alone(lambda: None)

    def ended_at(self, t: float, note: str = "") -> Ended:
        """The exception for a request of the FMU to end the simulation at a time [s]."""
        text = f"is the last one: the FMU requests the end of the simulation at t = {t:.9g} s{note}"
        ended = Ended(self.log.error_message("the step", text))
        ended.reached = t
        return ended

    def _call_whole(self, verb: str, variable: FmuVariable, cells: Any) -> None:
        arguments = *self.fmu.references([variable.reference]), *self.fmu.values(cells, len(cells))
        self.fmu.call(verb + variable.function_type, *arguments, variables=[variable.name])


class CoSimulationFmu(RunningFmu):
    """One instance of an FMU for Co-Simulation, as masters use it.

    Capabilities that the model description does not declare are tested on a spare instance.
    """

    def __init__(
        self,
        name: str,
        interface: FmuInterface,
        fmu: Location,
        start: Mapping[str, Value] | None = None,
        after: AfterCall = None,
    ) -> None:
        """`start`: start values of the spare instance; this one is set by `set`."""
        self._source, self._start = fmu, start or {}
        self._spare: CoSimulationFmu | None = None
        self._spare_fails = False  # to be opened
        self._cubic: bool | None = None
        self._final = True  # no step will be repeated
        self.event_mode = interface.event_mode
        super().__init__(name, interface, fmu, after)

    def setup(self, start: float, stop: float, tolerance: float | None) -> None:
        """Announce the experiment; times in [s]."""
        self._end_spare()
        super().setup(start, stop, tolerance)

    def exit(self) -> None:
        """Leave initialisation mode, and enter step mode, or event mode for the first event."""
        if self.event_mode:
            self.clocks.ask(self.interface.of("input"))
        super().exit()
        self.in_events = self.event_mode

    def close(self) -> None:
        """Terminate and free the instance, unload the library. May be repeated."""
        self._end_spare()
        super().close()

    # ---- capabilities

    def input_degree(self, variable: str, degree: int) -> int:
        """The highest degree (0, 1 or 3), up to `degree`, of a polynomial that the FMU accepts as input."""
        if variable not in self.interface.ramp_inputs or degree == 0:
            return 0
        if degree == 1 or not self.interface.can_interpolate_inputs:
            return 1
        if self._cubic is None:  # FMI 2.0 does not declare the highest order
            orders = [1, 2, 3]
            self._cubic = self._succeeds(
                lambda fmu: fmu.input_derivative_writer([variable] * 3, np.zeros(3), orders)
            )
        return 3 if self._cubic else 1

    def outputs_with_derivatives(self, outputs: Sequence[str]) -> Sequence[str]:
        """Those of the outputs whose first time derivatives the FMU provides; some FMUs omit a few."""
        if not self.interface.output_derivatives:
            return []

        def fails(names: Sequence[str]) -> bool:
            return (
                self._succeeds(lambda fmu: fmu.output_derivative_reader(names, np.zeros(len(names)))) is False
            )

        return [y for y in outputs if not fails([y])] if fails(outputs) else outputs

    def _succeeds(self, bind: Callable[[CoSimulationFmu], Call]) -> bool | None:
        """True if a call returns status OK on the spare instance; None if there is none.

        The instance is freed after a failed call, because the call may have left it in an invalid state.
        """
        self.fmu.check_open()
        if self._spare is None and not self._spare_fails:
            try:
                self._spare = self._spare_instance()
            except Problem:
                self._spare_fails = True
        if self._spare is None:
            return None
        try:
            bind(self._spare)()
        except Problem:
            self._end_spare()
            return False
        return self._spare.fmu.worst == 0

    def _end_spare(self) -> None:
        """Free the spare instance."""
        if self._spare is not None:
            self._spare.close()
            self._spare = None

    def _spare_instance(self) -> CoSimulationFmu:
        """Another instance, initialised and in step mode."""
        if self.interface.one_per_process:
            raise Problem(f"{self._label}: the FMU can be instantiated only once per process")
        interface = replace(self.interface, event_mode=False)
        other = CoSimulationFmu(self.name, interface, self._source, after=self.fmu.after)
        try:
            other.setup(0.0, 1.0, None)
            set_starts(other, self._start)
            other.enter()
            other.exit()
        except Problem:
            other.close()
            raise
        return other

    # ---- steps

    def step(self, t: float, h: float) -> None:
        """Advance from t to t + h [s]; raises Discarded, Ended or AtEvent with the time that it reached."""
        status = self.fmu.step(t, h, self._final)
        if status or self.fmu.flags.value:
            self._check_step(status)

    def _check_step(self, status: int) -> None:
        """Handle the status and the flags of a step; raise an exception if the step was not completed."""
        end, (begin, last) = self.fmu.step_end(status), self.log.clock[1:]
        rounding = 1e-6 * (last - begin)  # of times, which are up to 1e9 steps
        outside = ""
        if end.reached < begin - rounding or end.reached > last + rounding:
            outside = f", a time outside of the step from {begin:.9g} s to {last:.9g} s"
        at = f"t = {end.reached:.9g} s{outside}"
        if end.terminate and status != ERROR:
            ended = self.ended_at(end.reached, outside)
            ended.reached = float("nan") if outside else end.reached
            raise ended
        if outside:
            end = replace(end, reached=float("nan"))
        if status in (DISCARD, ERROR):
            reached = end.reached if status == DISCARD else float("nan")
            progress = f" (the FMU reached {at})" if status == DISCARD else ""
            details = f"with status {status_label(status)}{progress}"
            discarded = Discarded(self.log.error_message("the step failed", details))
            discarded.reached, self.fmu.worst = reached, max(self.fmu.worst, status)
            raise discarded
        if status:
            self.fmu.check_status(status, "the step")
        if end.early:
            stops = self.event_mode and self.interface.early_return
            lacks_time = stops and np.isnan(end.reached)
            if stops and not lacks_time:
                raise AtEvent(end.reached)
            forbidden = ", expected its time" if lacks_time else ", which was not allowed"
            text = f"ended early at {at}{'' if outside else forbidden}"
            raise Problem(self.log.error_message("the step", text))
        if end.event and self.event_mode:
            self._asks = True
        elif end.event:
            text = "the FMU requests event handling by the master, which is switched off"
            self.log.add(WARNING, f"{text} (event mode is not used)")

    def stepping(self, rolls: bool) -> StepCalls:
        """What C needs to step, and if it `rolls`, to save and restore the state."""
        fmu, states = self.fmu, {"get_state": "GetFMUState", "set_state": "SetFMUState"} if rolls else {}
        addresses = {member: fmu.address(function) for member, function in states.items()}
        checks = {
            address: partial(fmu.check_status, description=fmu.describe_call(states[member]))
            for member, address in addresses.items()
        }
        members = {"instance": fmu.handle.value or 0, "fmi": fmu.fmi, "do_step": fmu.address("DoStep")}
        members["events"] = int(self.event_mode)
        if fmu.results:
            members["flags"] = ctypes.addressof(fmu.flags)
        members |= zip(("event", "terminate", "early", "last"), fmu.results, strict=False)
        return StepCalls({**members, **addresses}, {0: self._check_step, **checks}, fmu.slot)

    # ---- rollback

    def save(self, state: ctypes.c_void_p | None = None) -> ctypes.c_void_p:
        """Save the FMU state, in a new object or over an earlier one; free it with `free_state`."""
        self._final = False
        return self.fmu.save(state)

    def restore(self, state: ctypes.c_void_p) -> None:
        """Restore a saved FMU state."""
        self.fmu.restore(state)
