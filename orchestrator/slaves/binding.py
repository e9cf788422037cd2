"""How the variables of an FMU are read and set.

Readers and writers are bound once to value references and a slice of a NumPy array; calling one is a
single call into the FMU without any allocation (types other than Float64 and Int32 are converted).
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import Problem
from orchestrator.slaves.access import Access, Derivative, fitting
from orchestrator.slaves.instance import Instance
from orchestrator.slaves.slave import Buffer, access
from orchestrator.slaves.values import address, packed, unpacked
from orchestrator.system.interface import Value


class BoundInstance(Instance):
    """An instance with calls for rows of variables, and for single ones."""

    def _references(self, variables: Sequence[str]) -> NDArray[np.uint32]:
        return np.array([self.interface.variables[v].reference for v in variables], np.uint32)

    def _listed(self, variables: Sequence[str]) -> tuple[Any, Any]:
        """Value references as the first arguments of a call."""
        found = [self.interface.variables[v].reference for v in variables]
        return (ctypes.c_uint * len(found))(*found), ctypes.c_size_t(len(found))

    def _access(
        self, name: str, variables: Sequence[str], values: Buffer, word: str, orders: Sequence[int] = ()
    ) -> Access:
        """The call of a function that gets or sets a row of variables of the type `word`."""
        count, kind = len(variables), self._fmi.types[word]
        own = fitting(values, count, kind)
        given = [(ctypes.c_int * count)(*orders)] if orders else []
        arguments = *self._listed(variables), *given, *self._fmi.array(address(own), count)
        return Access(
            call=self.calls.bound(name, *arguments, of=variables),
            address=self.calls.address(name),
            component=self.calls.handle.value or 0,
            fmi=self.interface.fmi,
            references=self._references(variables),
            orders=np.array(orders, np.int32) if orders else None,
            own=own,
            values=values[:count],
            sets=name.startswith("Set"),
            names=variables,
        )

    def reader(self, variables: Sequence[str], into: Buffer) -> Access:
        """A call that reads the variables into `into`, shape (n,)."""
        word = access(self.interface.variables[variables[0]])
        return self._access(f"Get{word}", variables, into, word)

    def writer(self, variables: Sequence[str], values: Buffer) -> Access:
        """A call that sets the variables to what stands in `values`, shape (n,)."""
        word = access(self.interface.variables[variables[0]])
        return self._access(f"Set{word}", variables, values, word)

    def slope_reader(self, variables: Sequence[str], into: Buffer) -> Access:
        """A call that reads the first time derivatives of outputs into `into`, shape (n,)."""
        return self._access(self._fmi.slopes, variables, into, self._real, [1] * len(variables))

    def slope_writer(self, variables: Sequence[str], slopes: Buffer, orders: Sequence[int] = ()) -> Access:
        """A call that gives inputs the time derivatives in `slopes`, shape (n,), for the next step.

        orders   of each derivative; default: all 1
        FMI 3.0 has no function for it; there the inputs that carry the derivatives are set.
        """
        orders = orders or [1] * len(variables)
        if self.interface.interpolates:
            return self._access("SetRealInputDerivatives", variables, slopes, self._real, orders)
        for v, order in zip(variables, orders, strict=True):
            if v not in self.interface.sloped or order != 1:
                raise Problem(f"{self.name}: {v}: the FMU takes no derivative of order {order} of this input")
        return self.writer([self.interface.rates[v] for v in variables], slopes)

    @property
    def _real(self) -> str:
        return "Real" if self.interface.fmi == 2 else "Float64"

    def derivative(self, of: Sequence[str], by: Sequence[str], seed: Buffer, into: Buffer) -> Derivative:
        """A call that puts into `into` the directional derivative of `of` when `by` move along `seed`."""
        name, given = "GetDirectionalDerivative", (*self._listed(of), *self._listed(by))
        seed, into = fitting(seed, len(by), ctypes.c_double), fitting(into, len(of), ctypes.c_double)
        seeds = self._fmi.array(address(seed), len(by))
        changes = self._fmi.array(address(into), len(of))
        return Derivative(
            call=self.calls.bound(name, *given, *seeds, *changes, of=of),
            address=self.calls.address(name),
            component=self.calls.handle.value or 0,
            fmi=self.interface.fmi,
            of=self._references(of),
            by=self._references(by),
            seed=seed,
            into=into,
        )

    # ---- single variables

    def get(self, variable: str) -> Value:
        """The value of one variable."""
        known = self.interface.variables[variable]
        cell = self._fmi.types[access(known)]()
        self._single("Get", variable, cell)
        return unpacked(known, cell)

    def set(self, variable: str, value: Value) -> None:
        """Set one variable of any kind."""
        known = self.interface.variables[variable]
        cell = packed(known, self._fmi.types[access(known)], value)
        structural = known.causality == "structuralParameter"
        if structural:
            self.calls.call("EnterConfigurationMode")
        self._single("Set", variable, cell)
        if structural:
            self.calls.call("ExitConfigurationMode")

    def _single(self, verb: str, variable: str, cell: Any) -> None:
        array = self._fmi.array(ctypes.c_void_p(ctypes.addressof(cell)), 1)
        word = access(self.interface.variables[variable])
        self.calls.call(verb + word, *self._listed([variable]), *array, of=[variable])
