"""A running FMU as masters use it: rows of variables, and for Co-Simulation steps, rollback and abilities."""

from __future__ import annotations

import ctypes
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from orchestrator.base.errors import Discarded, Ended, Problem
from orchestrator.base.files import Location
from orchestrator.fmi.calls import (
    Access,
    Buffer,
    Call,
    DirectionalDerivative,
    StepCalls,
    address,
    compatible_buffer,
    from_ctypes,
    function_type,
    to_ctypes,
)
from orchestrator.fmi.description import FmuInterface, Value
from orchestrator.fmi.instance import CallHook, FmuInstance, resources_location
from orchestrator.fmi.library import load_library
from orchestrator.fmi.messages import DISCARD, ERROR, FATAL, WARNING, Log, status_label

LOG_CATEGORIES = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")


class RunningFmu:
    """An instance from its instantiation to its end, and calls for its variables.

    before   is called before each call, see `Instance`
    """

    exchange = False

    def __init__(
        self, name: str, interface: FmuInterface, fmu: Location, before: CallHook | None = None
    ) -> None:
        names = {v.reference: v.name for v in interface.variables.values()} if interface.fmi == 3 else {}
        self.name, self.interface, self.log = name, interface, Log(name, names)
        self._label, self._stepping, self._before = f"{name} ({fmu})", False, before
        self._undo = ExitStack()
        try:
            self._open(fmu)
        except BaseException:
            self.close()
            raise

    def _open(self, fmu: Location) -> None:
        face = self.interface
        folder = fmu.path.resolve() if fmu.is_folder else Path(tempfile.mkdtemp(prefix="fmu-"))
        if not fmu.is_folder:
            self._undo.callback(shutil.rmtree, folder, ignore_errors=True)
            fmu.extract(folder)
        library = load_library(folder, face.identifier, face.fmi, self._label)
        self.fmu = FmuInstance(library, self.log, self.exchange, self._before)
        self._undo.callback(self._unless_fatal, library.close)
        self._undo.callback(self.fmu.free)
        place = resources_location(folder, face.fmi)
        if not any(self.fmu.instantiate(face.guid, place, verbose=verbose) for verbose in (False, True)):
            # the second, verbose try made it say what is wrong
            raise Problem(f"{self._label}: the FMU could not be instantiated{self.log.quoted_messages()}")
        wanted = [c.encode() for c in LOG_CATEGORIES if c in face.categories]
        if wanted:
            array = (ctypes.c_char_p * len(wanted))(*wanted)
            with suppress(Problem):  # an FMU that cannot choose its messages still runs
                self.fmu.status("SetDebugLogging", self.fmu.flag(True), ctypes.c_size_t(len(wanted)), array)

    def _unless_fatal(self, call: Call) -> None:
        """After a fatal error nothing of the FMU may be called any more."""
        if self.fmu.worst < FATAL:
            call()

    def setup(self, start: float, stop: float, tolerance: float | None) -> None:
        """Announce the experiment; times in [s]."""
        self.fmu.setup(start, stop, tolerance)

    def enter(self) -> None:
        """Enter initialisation mode."""
        self.fmu.enter()

    def exit(self) -> None:
        """Leave initialisation mode; steps may follow."""
        self.fmu.leave()
        self._stepping = True

    def close(self) -> None:
        """Terminate and free the instance, unload the library, remove the unpacked files. May be repeated."""
        if self._stepping and self.fmu.worst < ERROR:
            self._stepping = False
            with suppress(Problem):
                self.fmu.call("Terminate")
        self._undo.close()

    # ---- rows of variables

    def _references(self, variables: Sequence[str]) -> list[int]:
        return [self.interface.variables[v].reference for v in variables]

    def _access(
        self, function: str, variables: Sequence[str], values: Buffer, word: str, orders: Sequence[int] = ()
    ) -> Access:
        """The call of a function that gets or sets a row of variables of the type `word`."""
        count, references = len(variables), self._references(variables)
        own = compatible_buffer(values, count, self.fmu.types[word])
        given = [(ctypes.c_int * count)(*orders)] if orders else []
        arguments = *self.fmu.references(references), *given, *self.fmu.values(address(own), count)
        return Access(
            call=self.fmu.bound(function, *arguments, of=variables),
            address=self.fmu.address(function),
            component=self.fmu.handle.value or 0,
            fmi=self.interface.fmi,
            references=np.array(references, np.uint32),
            orders=np.array(orders, np.int32) if orders else None,
            fmu_values=own,
            values=values[:count],
            sets=function.startswith("Set"),
            names=variables,
        )

    def reader(self, variables: Sequence[str], into: Buffer) -> Access:
        """A call that reads the variables into `into`, shape (n,)."""
        word = function_type(self.interface.variables[variables[0]])
        return self._access(f"Get{word}", variables, into, word)

    def writer(self, variables: Sequence[str], values: Buffer) -> Access:
        """A call that sets the variables to what stands in `values`, shape (n,)."""
        word = function_type(self.interface.variables[variables[0]])
        return self._access(f"Set{word}", variables, values, word)

    def output_derivative_reader(self, variables: Sequence[str], into: Buffer) -> Access:
        """A call that reads the first time derivatives of outputs into `into`, shape (n,)."""
        return self._access("GetOutputDerivatives", variables, into, self._real, [1] * len(variables))

    def input_derivative_writer(
        self, variables: Sequence[str], slopes: Buffer, orders: Sequence[int] = ()
    ) -> Access:
        """A call that gives inputs the time derivatives in `slopes`, shape (n,), for the next step.

        orders   of each derivative; default: all 1
        FMI 3.0 has no function for it; there the inputs that carry the derivatives are set.
        """
        orders = orders or [1] * len(variables)
        if self.interface.can_interpolate_inputs:
            return self._access("SetRealInputDerivatives", variables, slopes, self._real, orders)
        for v, order in zip(variables, orders, strict=True):
            if v not in self.interface.ramp_inputs or order != 1:
                raise Problem(f"{self.name}: {v}: the FMU takes no derivative of order {order} of this input")
        return self.writer([self.interface.rate_inputs[v] for v in variables], slopes)

    @property
    def _real(self) -> str:
        return "Real" if self.interface.fmi == 2 else "Float64"

    def directional_derivative(
        self, of: Sequence[str], by: Sequence[str], seed: Buffer, into: Buffer
    ) -> DirectionalDerivative:
        """A call that puts into `into` the directional derivative of `of` when `by` move along `seed`."""
        function, unknowns, knowns = "GetDirectionalDerivative", self._references(of), self._references(by)
        seed, into = (
            compatible_buffer(seed, len(by), ctypes.c_double),
            compatible_buffer(into, len(of), ctypes.c_double),
        )
        given = *self.fmu.references(unknowns), *self.fmu.references(knowns)
        seeds = self.fmu.values(address(seed), len(by))
        changes = self.fmu.values(address(into), len(of))
        return DirectionalDerivative(
            call=self.fmu.bound(function, *given, *seeds, *changes, of=of),
            address=self.fmu.address(function),
            component=self.fmu.handle.value or 0,
            fmi=self.interface.fmi,
            unknowns=np.array(unknowns, np.uint32),
            knowns=np.array(knowns, np.uint32),
            seed=seed,
            sensitivity=into,
        )

    # ---- single variables

    def get(self, variable: str) -> Value:
        """The value of one variable."""
        known = self.interface.variables[variable]
        cell = self.fmu.types[function_type(known)]()
        self._single("Get", variable, cell)
        return from_ctypes(known, cell)

    def set(self, variable: str, value: Value) -> None:
        """Set one variable of any kind."""
        known = self.interface.variables[variable]
        cell = to_ctypes(known, self.fmu.types[function_type(known)], value)
        structural = known.causality == "structuralParameter"
        if structural:
            self.fmu.call("EnterConfigurationMode")
        self._single("Set", variable, cell)
        if structural:
            self.fmu.call("ExitConfigurationMode")

    def _single(self, verb: str, variable: str, cell: Any) -> None:
        known = self.interface.variables[variable]
        given = *self.fmu.references([known.reference]), *self.fmu.values(ctypes.byref(cell), 1)
        self.fmu.call(verb + function_type(known), *given, of=[variable])


class CoSimulationFmu(RunningFmu):
    """One instance of an FMU for Co-Simulation, as masters use it."""

    def __init__(
        self,
        name: str,
        interface: FmuInterface,
        fmu: Location,
        start: Mapping[str, Value] | None = None,
        before: CallHook | None = None,
    ) -> None:
        """start: values for instances that only try what the FMU does; this one gets its own by `set`."""
        self._source, self._start = fmu, start or {}
        self._trial = CapabilityTrial(self._spare_instance)
        self._cubic: bool | None = None
        self._final = True  # no step will be repeated
        self.busy = 0.0
        super().__init__(name, interface, fmu, before)

    def setup(self, start: float, stop: float, tolerance: float | None) -> None:
        """Announce the experiment; times in [s]."""
        self._trial.end()
        super().setup(start, stop, tolerance)

    def close(self) -> None:
        """Terminate and free the instance, unload the library, remove the unpacked files. May be repeated."""
        self._trial.end()
        super().close()

    # ---- what it is able to

    def input_degree(self, variable: str, degree: int) -> int:
        """The highest degree of a polynomial, up to `degree`, that an input can be given: 0, 1 or 3."""
        if variable not in self.interface.ramp_inputs or degree == 0:
            return 0
        if degree == 1 or not self.interface.can_interpolate_inputs:
            return 1
        if self._cubic is None:  # FMI 2.0 has no declaration for it
            ask = partial(
                CoSimulationFmu.input_derivative_writer,
                variables=[variable] * 3,
                slopes=np.zeros(3),
                orders=[1, 2, 3],
            )
            self._cubic = self._trial.succeeds(ask) or False
        return 3 if self._cubic else 1

    def outputs_with_derivatives(self, outputs: Sequence[str]) -> Sequence[str]:
        """Those of the outputs whose first time derivatives the FMU gives; some give only those of states."""
        if self.interface.max_output_derivative_order < 1:
            return []

        def refused(names: Sequence[str]) -> bool:
            ask = partial(
                CoSimulationFmu.output_derivative_reader, variables=names, into=np.zeros(len(names))
            )
            return self._trial.succeeds(ask) is False

        return [y for y in outputs if not refused([y])] if refused(outputs) else outputs

    def _spare_instance(self) -> CoSimulationFmu:
        """One more instance, ready for its first step."""
        if self.interface.one_per_process:
            raise Problem(f"{self._label}: the FMU can be instantiated only once per process")
        other = CoSimulationFmu(self.name, self.interface, self._source)
        try:
            other.setup(0.0, 1.0, None)
            for variable, value in self._start.items():
                other.set(variable, value)
            other.enter()
            other.exit()
        except Problem:
            other.close()
            raise
        return other

    # ---- steps

    def step(self, t: float, h: float) -> None:
        """Advance from t to t + h [s]; raises Discarded and Ended, which say how far it got."""
        began = perf_counter()
        status = self.fmu.step(t, h, self._final)
        self.busy += perf_counter() - began
        if status or self.fmu.flags.value:
            self._judge_step(status)

    def _judge_step(self, status: int) -> None:
        """Judge a step whose status is not OK or which wants something."""
        end = self.fmu.step_end(status)
        if end.terminate and status != ERROR:
            text = f"is the last: the FMU asks to end the simulation at t = {end.reached:.9g} s"
            ended = Ended(self.log.error_message("the step", text))
            ended.reached = end.reached
            raise ended
        if status in (DISCARD, ERROR):
            reached = end.reached if status == DISCARD else float("nan")
            far = f" (the FMU got as far as t = {reached:.9g} s)" if status == DISCARD else ""
            discarded = Discarded(
                self.log.error_message("the step failed", f"with status {status_label(status)}{far}")
            )
            discarded.reached, self.fmu.worst = reached, max(self.fmu.worst, status)
            raise discarded
        if status:
            self.fmu.check_status(status, "the step")
        if end.early:
            text = f"ended early at t = {end.reached:.9g} s, which was not allowed"
            raise Problem(self.log.error_message("the step", text))
        if end.event:
            self.log.add(WARNING, "the FMU asks for event handling, which it was told to do itself")

    def stepping(self, rolls: bool) -> StepCalls:
        """What it takes to step from C; rolls: the state is to be saved and restored, too."""
        get, set_ = "GetFMUState", "SetFMUState"
        return StepCalls(
            component=self.fmu.handle.value or 0,
            fmi=self.interface.fmi,
            do_step=self.fmu.address("DoStep"),
            get_state=self.fmu.address(get) if rolls else 0,
            set_state=self.fmu.address(set_) if rolls else 0,
            results=self.fmu.results,
            flags=ctypes.addressof(self.fmu.flags) if self.fmu.results else 0,
            check_step=self._judge_step,
            check_get=lambda status: self.fmu.check_status(status, self.fmu.describe_call(get)),
            check_set=lambda status: self.fmu.check_status(status, self.fmu.describe_call(set_)),
            clock=np.ctypeslib.as_array(self.log.clock),
        )

    # ---- rollback

    def save(self, state: ctypes.c_void_p | None = None) -> ctypes.c_void_p:
        """A snapshot of the FMU's state, written over an earlier one if given; give it back with `forget`."""
        self._final = False
        return self.fmu.save(state)

    def restore(self, state: ctypes.c_void_p) -> None:
        """Go back to a snapshot."""
        self.fmu.restore(state)

    def after_rollback(self) -> None:
        """Forget what the FMU said and returned in a step that is going to be repeated from a saved state."""
        self.log.discard_repeated()
        if self.fmu.worst < FATAL:
            self.fmu.worst = min(self.fmu.worst, WARNING)

    def free_state(self, state: ctypes.c_void_p) -> None:
        """Free a snapshot; after an error it is only tried."""
        with suppress(Problem) if self.fmu.worst >= ERROR else nullcontext():
            self._unless_fatal(partial(self.fmu.free_state, state))

    def serialize(self, state: ctypes.c_void_p) -> bytes:
        """A snapshot as bytes, for another process."""
        return self.fmu.serialize(state)

    def deserialize(self, data: bytes) -> ctypes.c_void_p:
        """The snapshot in bytes that `pack` made; give it back with `forget`."""
        return self.fmu.deserialize(data)


class CapabilityTrial:
    """Tries what the description of an FMU leaves open, on an instance that nobody uses.

    An instance that refused a call is given up, because an error may have broken it.
    """

    def __init__(self, fresh: Callable[[], CoSimulationFmu]) -> None:
        """fresh: makes an instance that is ready for its first step, or raises Problem."""
        self._fresh, self._able = fresh, True
        self._instance: CoSimulationFmu | None = None

    def succeeds(self, ask: Callable[[CoSimulationFmu], Call]) -> bool | None:
        """Does the FMU do this without a complaint? None: there is no instance to try it on."""
        if self._instance is None and self._able:
            try:
                self._instance = self._fresh()
            except Problem:
                self._able = False
        if self._instance is None:
            return None
        try:
            ask(self._instance)()
        except Problem:
            self.end()
            return False
        return self._instance.fmu.worst == 0

    def end(self) -> None:
        """Free the instance."""
        if self._instance is not None:
            self._instance.close()
            self._instance = None
