"""Rules of FMI 2.0.4 on which an importer may rely, beyond the calls that every tool makes."""

import ctypes

import fmpy
import numpy as np
import pytest

DISCARD, ERROR = 2, 3


# ---- which function may be called when ---------------------------------------------------------------


def test_nominals_are_known_before_the_initialisation(open_fmu):
    """fmi2GetNominalsOfContinuousStates is allowed as soon as there is an instance (table in 3.2.3).

    They are a ten-thousandth of the magnitudes in modelDescription.xml: importers make tolerances of them.
    """
    fmu = open_fmu("chamber", "me")
    nominals = (ctypes.c_double * 3)()
    fmu.fmu.fmi2GetNominalsOfContinuousStates(fmu.fmu.component, nominals, 3)
    np.testing.assert_allclose(nominals, [1e3, 1e-8, 0.01], rtol=1e-15)  # rounding of a product


@pytest.mark.parametrize(
    ("kind", "function", "arguments"),
    [
        ("cs", "fmi2GetContinuousStates", ((ctypes.c_double * 3)(), 3)),
        ("cs", "fmi2GetEventIndicators", (None, 0)),
        ("cs", "fmi2EnterEventMode", ()),
        ("me", "fmi2SetRealInputDerivatives", (None, 0, None, None)),
        ("me", "fmi2DoStep", (ctypes.c_double(0.0), ctypes.c_double(1.0), 1)),
        ("me", "fmi2GetRealStatus", (2, ctypes.byref(ctypes.c_double()))),
    ],
)
def test_functions_of_the_other_kind_are_refused(open_fmu, kind, function, arguments):
    """What only model exchange or only co-simulation has is an error in an instance of the other kind."""
    fmu = open_fmu("chamber", kind)
    for begin in (fmu.enter, fmu.fmu.exitInitializationMode):
        begin()
        assert getattr(fmu.fmu.dll, function)(ctypes.c_void_p(fmu.fmu.component), *arguments) == ERROR
        assert f"{function}: not allowed" in fmu.errors()[-1]


def test_tunable_parameters_change_at_events(open_fmu):
    """In model exchange a tunable parameter is set in event mode, an input at any time (3.2.3)."""
    fmu = open_fmu("decay", "me").initialise().set(rate=3.0, target=5.0)
    assert fmu["der_level"] == 3.0 * (5.0 - 1.0)
    fmu.update()
    fmu.fmu.enterContinuousTimeMode()
    fmu.set(target=2.0)
    assert fmu["der_level"] == 3.0 * (2.0 - 1.0)
    for call in (lambda: fmu.set(rate=1.0), lambda: fmu.set(level=1.0), lambda: fmu.set(gain=1.0)):
        fmu.refuses(call)
    fmu.fmu.enterEventMode()
    fmu.set(rate=1.0)
    assert fmu["der_level"] == 1.0


@pytest.mark.parametrize(
    ("name", "kind", "word"), [(b" \t", 1, "name is empty"), (None, 1, "name is empty"), (b"a", 7, "type")]
)
def test_instance_without_a_name_or_a_kind_is_refused(open_fmu, name, kind, word):
    """No instance, and a message that tells why."""
    fmu = open_fmu("gain")
    instantiate = fmu.fmu.dll.fmi2Instantiate
    instantiate.restype = ctypes.c_void_p
    made = instantiate(name, kind, fmu.fmu.guid.encode(), None, ctypes.byref(fmu.fmu.callbacks), 0, 0)
    assert made is None
    assert word in fmu.errors()[-1]


# ---- messages ----------------------------------------------------------------------------------------


def test_discard_is_told_in_debug_mode_only(open_fmu):
    """A derivative outside its domain is fmi2Discard; a message only if debug logging is on (2.1.3)."""
    told = {}
    for logging in (False, True):
        fmu = open_fmu("blowup", "me", loggingOn=logging)
        fmu.set(fuel=-1.0)
        fmu.enter()
        values = (ctypes.c_double * 2)()
        get = fmu.fmu.dll.fmi2GetDerivatives
        assert get(ctypes.c_void_p(fmu.fmu.component), values, ctypes.c_size_t(2)) == DISCARD
        told[logging] = fmu.logged("logStatusDiscard")
    assert told[False] == []
    assert "fmi2GetDerivatives: the derivative of fuel is" in told[True][0]


def test_escapes_of_the_logger_are_doubled(open_fmu):
    """The characters "#" and "%" are doubled in messages, because loggers interpret them (2.1.5)."""
    fmu = open_fmu("decay")
    fmu.refuses(lambda: fmu.fmu.setDebugLogging(True, ["#r1#"]))
    assert 'category "##r1##" is unknown' in fmu.errors()[-1]


def test_debug_logging_off_leaves_warnings_and_errors(open_fmu):
    """Switching logging on and off again restores the initial categories."""
    fmu = open_fmu("decay", loggingOn=True).start()
    fmu.fmu.setDebugLogging(False, [])
    fmu.messages.clear()
    fmu.set(target=50.0, rate=20.0)
    fmu.fmu.doStep(0.0, 1.0)
    fmu.refuses(lambda: fmu.set(target=101.0))
    assert [category for category, _ in fmu.messages] == ["logStatusWarning", "logStatusError"]


# ---- saved states ------------------------------------------------------------------------------------


def test_deserialising_makes_a_new_state(open_fmu):
    """fmi2DeSerializeFMUstate writes the pointer, whatever it held before."""
    fmu = open_fmu("decay").start()
    saved = fmu.fmu.getFMUstate()
    data = fmu.fmu.serializeFMUstate(saved)
    state = ctypes.c_void_p(1)  # no memory of ours
    fmu.fmu.fmi2DeSerializeFMUstate(fmu.fmu.component, data, len(data), ctypes.byref(state))
    assert state.value not in (None, 1, saved.value)
    for s in (saved, state):
        fmu.fmu.freeFMUstate(s)


# ---- derivatives -------------------------------------------------------------------------------------


def test_output_derivatives_of_higher_order_are_zero(open_fmu):
    """Derivatives of orders that are not provided are 0; order 0 is an error (4.2.1)."""
    fmu = open_fmu("decay").start()
    mixed, slopes = fmu.references["mixed"], fmu.fmu.getRealOutputDerivatives
    assert list(slopes([mixed] * 2, [2, 3])) == [0.0, 0.0]
    fmu.refuses(lambda: slopes([mixed], [0]), "order of the derivative of mixed")


def test_output_derivative_follows_the_given_input_derivative(open_fmu):
    """After a step with an input derivative, output derivatives use it and not the rate port."""
    fmu = open_fmu("path").start()
    fmu.slopes(position=2.0)
    fmu.slopes(2, position=6.0)
    fmu.step(0.5)
    assert fmu.output_slopes("where") == [2.0 + 6.0 * 0.5]
    fmu.set(velocity=1.5)
    fmu.step(0.5)
    assert fmu.output_slopes("where") == [1.5]


@pytest.mark.parametrize("known", ["volume", "conductance", "supply", "heat"])
def test_directional_derivatives_at_the_start_have_all_knowns(open_fmu, known):
    """In initialisation mode parameters, inputs and start values are knowns, through the start equations."""
    fmu = open_fmu("chamber")
    unknowns = ["pressure", "flow", "der_pressure", "der_flow", "der_heat", "force", "pressure_rate"]
    point = {"volume": 1e-4, "conductance": 1e-11, "supply": 2e7, "heat": 3.0}
    fmu.set(opening=0.9, **point)
    fmu.enter()
    delta = 1e-4 * point[known]
    rows = []
    for sign in (1, -1):
        fmu.set(**{known: point[known] + sign * delta})
        rows.append(fmu.get(*unknowns))
    fmu.set(**{known: point[known]})
    refs, found = [fmu.references[n] for n in unknowns], fmu.derivative(unknowns, [known])[:, 0]
    twice = fmu.fmu.getDirectionalDerivative(refs, [fmu.references[known]] * 2, [0.5, 0.5])
    expected = (rows[0] - rows[1]) / (2 * delta)
    # central differences: curvature of relative size delta^2 = 1e-8; the pressure rate is a difference of
    # flows, 16e12 Pa/m3 times 1e-4 m3/s, with rounding 1e-16 / 1e-4
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-3 / point[known])
    assert list(twice) == list(found)


def test_infinite_directional_derivative_is_an_error(open_fmu):
    """The root of fuel at fuel = 0 has no finite slope: an error that names the unknown."""
    fmu = open_fmu("blowup").start(fuel=0.0)
    fmu.refuses(lambda: fmu.derivative(["der_fuel"], ["fuel"]), "the derivative of der_fuel is not finite")


def test_start_values_of_parameters_can_be_read_as_fmpy_does(toy_dir):
    """Without fmi2SetupExperiment, as in FMPy's reader of start values, the values are those of the XML."""
    from fmpy.util import get_start_values

    found = get_start_values(str(toy_dir / "chamber.fmu"))
    variables = fmpy.read_model_description(str(toy_dir / "chamber.fmu")).modelVariables
    declared = {v.name: float(v.start) for v in variables if v.start}
    assert {name: float(found[name]) for name in declared} == declared
