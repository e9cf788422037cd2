"""Wrong calls and wrong numbers: an error status, and a message that names function, variable and time."""

import ctypes
import math

import pytest
from kit.mistakes import table


def test_wrong_guid_gives_no_instance(open_fmu):
    """A binary of another build is refused at once."""
    with pytest.raises(Exception, match="instantiate"):
        open_fmu("decay", token="{other}")


@pytest.mark.parametrize(
    ("call", "function", "started"),
    [
        (lambda f: f.fmu.doStep(0.0, 0.1), "DoStep", False),
        (lambda f: f.fmu.exitInitializationMode(), "ExitInitializationMode", False),
        (lambda f: f.fmu.terminate(), "Terminate", False),
        (lambda f: f.output_slopes("level"), "GetRealOutputDerivatives", False),
        (lambda f: f.fmu.setupExperiment(), "SetupExperiment", True),
        (lambda f: f.fmu.enterInitializationMode(), "EnterInitializationMode", True),
    ],
)
def test_call_in_a_wrong_state_names_function_and_state(open_fmu, call, function, started):
    """Before its time or after it a function is refused."""
    fmu = open_fmu("decay").start() if started else open_fmu("decay")
    state = "step complete" if started else "instantiated"
    fmu.refuses(lambda: call(fmu), f"fmi2{function}: not allowed", state)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_value_that_is_no_number_is_refused_by_name(open_fmu, value):
    """NaN and infinity are refused for all variables."""
    fmu = open_fmu("decay").start().step(0.25)
    fmu.refuses(lambda: fmu.set(target=value), "fmi2SetReal: target", "t = 0.25 s", "finite")
    fmu.refuses(lambda: fmu.slopes(target=value), "fmi2SetRealInputDerivatives", "target")
    assert fmu["target"] == 0.0


def test_values_out_of_bounds_are_refused_with_the_bounds(open_fmu):
    """Parameters and inputs keep to min and max; nothing of the call is applied."""
    fmu = open_fmu("decay")
    fmu.refuses(lambda: fmu.set(rate=7.0, gain=11.0), "gain", "11", "expected 0 to 10")
    assert fmu["rate"] == 2.0
    fmu.start()
    fmu.refuses(lambda: fmu.set(target=-101.0), "target", "-101", "expected -100 to 100")


def test_fixed_parameter_is_refused_while_running_and_tunable_is_not(open_fmu):
    """Only tunable parameters and inputs can be set after the initialisation."""
    fmu = open_fmu("decay").start().step(0.5)
    fmu.refuses(lambda: fmu.set(gain=1.0), "gain", "fixed parameter", "t = 0.5 s")
    fmu.refuses(lambda: fmu.set(level=1.0), "level", "state")
    fmu.refuses(lambda: fmu.set(mixed=1.0), "mixed", "output")
    fmu.set(rate=0.0)
    before = fmu["level"]
    fmu.fmu.doStep(0.5, 0.5)
    assert fmu["level"] == before


def test_start_values_act_before_and_in_initialisation(open_fmu):
    """States and inputs set early determine initial states and outputs; a calculated state cannot be set."""
    fmu = open_fmu("decay")
    fmu.set(level=4.0)
    fmu.enter()
    fmu.set(target=1.0)
    assert fmu["mixed"] == 13.0
    fmu.set(level=2.0, gain=2.0)
    assert fmu.get("mixed", "der_level").tolist() == [5.0, -2.0]
    chamber = open_fmu("chamber")
    chamber.refuses(lambda: chamber.set(pressure=1e5), "pressure", "calculated")
    chamber.enter()
    for supply in (1e7, 2e7):
        chamber.set(supply=supply)
        assert chamber["pressure"] == supply / 2


@table(__file__, "steps", "time, step, word")
def test_impossible_step_is_refused(open_fmu, time, step, word):
    """Impossible step sizes and times are refused with their values, and the simulation can continue."""
    fmu = open_fmu("decay").start(stop=10.0)
    fmu.refuses(lambda: fmu.fmu.doStep(time, step), "fmi2DoStep: the ", word)
    fmu.fmu.doStep(0.0, 0.1)


def test_times_of_a_running_sum_are_accepted(open_fmu):
    """Rounding of a time that is summed up over 20 minutes at 60 steps per second is accepted."""
    fmu = open_fmu("gain").start(stop=1200.0)
    step, time = 1 / 60, 0.0
    for _ in range(72000):
        fmu.fmu.doStep(time, step)
        time += step
    assert time != 1200.0


def test_a_violated_requirement_is_told_with_its_time(open_fmu):
    """At the end of the initialisation, or by the step, after which no further step is possible."""
    fmu = open_fmu("chamber")
    fmu.set(burst=5e6)
    fmu.refuses(fmu.start, "fmi2ExitInitializationMode", "below 100 % of burst", "t = 0 s", "-5e+06")
    fmu = open_fmu("chamber").start(burst=1.2e7)
    fmu.refuses(lambda: fmu.step(0.001, 100), "fmi2DoStep", "below 100 % of burst", "violated at t = 0.0")
    fmu.refuses(lambda: fmu.fmu.doStep(0.0, 0.001), "not allowed", "failed")


def test_solution_that_leaves_all_bounds_or_is_no_number_is_an_error(open_fmu):
    """x' = x^2 from 1 ends at t = 1, no huge number; the root of a negative fuel: both name the state."""
    fmu = open_fmu("blowup").start()
    fmu.refuses(lambda: fmu.step(0.1, 20), "fmi2DoStep", "the largest error is in size", "t = ")
    time = float(fmu.errors()[-1].split("t = ")[1].split(" s")[0])
    # the pole is at 1; integrator error at tolerance 1e-6 moves it a little
    assert time == pytest.approx(1.0, abs=1e-4)
    fmu = open_fmu("blowup").start(size=0.0, fuel=-1.0)
    fmu.refuses(lambda: fmu.fmu.doStep(0.0, 0.1), "derivative of fuel", "t = 0 s")


@table(__file__, "excursions", "start, targets, told")
def test_watched_output_warns_once_per_excursion(open_fmu, start, targets, told):
    """Beyond the limit of 5; a ramp that ends at the limit exceeds it by rounding only: no excess."""
    fmu = open_fmu("decay").start(**start)
    for k, target in enumerate(targets):
        fmu.set(target=target)
        fmu.fmu.doStep(float(k), 1.0)
    warnings = fmu.logged("logStatusWarning")
    assert len(warnings) == len(told)
    assert all(f"limit at {words} (limit 5)" in text for words, text in zip(told, warnings, strict=True))


def test_a_value_below_its_lowest_is_a_warning(open_fmu):
    """A state that is an output: once while it is below, again after it was above; not at the limit."""
    fmu = open_fmu("decay").start(rate=20.0)
    for k, target in enumerate((-60.0, -70.0, -70.0, 0.0, -80.0)):
        fmu.set(target=target)
        fmu.fmu.doStep(float(k), 1.0)
    said = [w.partition(": ")[2] for w in fmu.logged("logStatusWarning") if "level" in w]
    told = "it is dry at t = {} s: level = {} (lower limit -60): fill it"
    assert said == [told.format(*at) for at in ((2, -70), (5, -80))]


def test_a_repeated_warning_is_logged_three_times(open_fmu):
    """The third one says so; the other variables go on to warn."""
    fmu = open_fmu("decay").start()
    for k in range(10):
        fmu.set(target=50.0 * (k % 2), rate=20.0)
        fmu.fmu.doStep(float(k), 1.0)
    said = [w for w in fmu.logged("logStatusWarning") if "mixed" in w]
    assert ["no further warning of it follows" in w for w in said] == [False, False, True]


@table(__file__, "held", "positions, velocity, named")
def test_held_inputs_are_named_once_with_the_first_warning(open_fmu, positions, velocity, named):
    """An input that moves in each step while its rate input stays 0 may be the cause; a jump is none."""
    fmu = open_fmu("path", loggingOn=True).start()
    for k, position in enumerate(positions):
        fmu.set(position=position, velocity=velocity)
        fmu.fmu.doStep(float(k), 1.0)
    assert sum("stayed 0" in event for event in fmu.logged("logEvents")) == named  # once
    told, *others = fmu.logged("logStatusWarning") if named else ("", *fmu.logged("logStatusWarning"))
    assert ["where = 9" in warning for warning in others] == [True]
    if named:
        assert "position moved in each of the last 4 steps while its rate input velocity stayed 0" in told


@pytest.mark.parametrize(
    ("position", "velocity", "step"),
    [
        (lambda k: 0.1 * (-1) ** k, lambda k: -10.0 * (-1) ** k, "0.01"),  # 0.2 m over 20 m/s
        (lambda _: 0.0, lambda _: -4.0, "0.02"),  # a quarter of the step
        (lambda k: 0.08 * k, lambda _: 1.0, ""),
        (lambda k: math.sin(0.1 * k), lambda k: math.cos(0.1 * k) / 0.8, ""),
    ],
)
def test_a_rate_that_the_input_does_not_follow_is_named_once(open_fmu, position, velocity, step):
    """After 100 steps of 80 ms, with the step that resolves it; of true rates nothing is said."""
    fmu = open_fmu("path").start()
    for k in range(150):
        fmu.set(position=position(k), velocity=velocity(k), acceleration=1e-3)
        fmu.fmu.doStep(0.08 * k, 0.08)
    words = "position did not move in the last 100 steps as its rate input velocity says, which is held over "
    words += f"a step: leave that open, or take steps of at most {step} s"
    assert [w.partition(": ")[2] for w in fmu.logged("logStatusWarning")] == [words] * bool(step)


def test_log_categories_are_filtered(open_fmu):
    """Only the requested categories are logged; an unknown category is refused."""
    fmu = open_fmu("decay", loggingOn=True)
    fmu["level"]
    assert ("logEvents", "fmi2GetReal: t = 0 s") in fmu.messages
    fmu.fmu.setDebugLogging(False, ["logEvents", "logStatusError"])
    fmu.messages.clear()
    fmu.refuses(lambda: fmu.set(target=math.nan))
    assert fmu.messages == []
    fmu.fmu.setDebugLogging(True, ["logStatusError"])
    fmu.refuses(lambda: fmu.fmu.setDebugLogging(True, ["logNonsense"]), "logNonsense")


def test_variables_of_other_types_do_not_exist(open_fmu):
    """Integer, Boolean and String functions refuse any variable, and unknown references are named."""
    fmu = open_fmu("decay").start()
    for call in (fmu.fmu.getInteger, fmu.fmu.getBoolean, fmu.fmu.getString):
        fmu.refuses(lambda call=call: call([0]), "Real variables only")
        assert call([]) == []
    for far in (len(fmu.references), 99, 2**32 - 1):
        words = (f"value reference {far} is unknown", "expected 0 to")
        fmu.refuses(lambda far=far: fmu.fmu.getReal([far]), *words)
    fmu.refuses(lambda: fmu.fmu.setReal([99], [0.0]), "value reference 99")


def test_status_functions_answer(open_fmu):
    """The time of the last successful step, and no pending step to cancel."""
    fmu = open_fmu("decay").start().step(0.25, 2)
    value = ctypes.c_double()
    library = fmu.fmu.dll
    component = ctypes.c_void_p(fmu.fmu.component)
    assert library.fmi2GetRealStatus(component, 2, ctypes.byref(value)) == 0
    assert value.value == 0.5
    assert library.fmi2CancelStep(component) == 3
    assert "no step is in progress" in fmu.errors()[-1]
