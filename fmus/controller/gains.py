"""Gains, limits and time constants of the controller; numbers, sources and notes in parameters.toml."""

from __future__ import annotations

from fmus.contract import Group, Quantity, Scalar


class Gains(Group):
    """What is the controller's own; geometry and hydraulics it takes from the machine's parts."""

    feedback: Scalar = Quantity(
        "1",
        "0: feedforward at nominal pressures only, 1: with feedback of motion and pressures",
        minimum=0.0,
        maximum=1.0,
        tunable=True,
        group="Feedback",
    )
    swing_position_gain: Scalar = Quantity(
        "1/s", "Speed wanted per error of the swing", 5.0, minimum=0.0, tunable=True
    )
    swing_integral_gain: Scalar = Quantity(
        "1/s2", "Rate of the speed by the swing's integrator per error", 10.0, minimum=0.0, tunable=True
    )
    swing_damping_rate: Scalar = Quantity(
        "1/s", "Rate at which pressure feedback lets the swing's torque decay", 5.0, minimum=0.0, tunable=True
    )
    swing_load_time: Scalar = Quantity(
        "s", "Time over which its torque counts as steady: high-pass of that feedback"
    )
    piston_position_gain: Scalar = Quantity(
        "1/s", "Speed wanted per error of a piston", 5.0, minimum=0.0, tunable=True
    )
    piston_integral_gain: Scalar = Quantity(
        "1/s2", "Rate of the speed by a piston's integrator per error", 10.0, minimum=0.0, tunable=True
    )
    piston_damping_rate: Scalar = Quantity(
        "1/s", "Rate at which pressure feedback lets a piston's force decay", 5.0, minimum=0.0, tunable=True
    )
    piston_load_time: Scalar = Quantity(
        "s", "Time over which a piston's force counts as steady, in the same way"
    )
    gain_limit: Scalar = Quantity("1", "Largest correction of the feedforward, as share of it", minimum=1e-3)
    learning_share: Scalar = Quantity(
        "1", "Share of the speed limit below which the correction learns little", 0.01, minimum=1e-6
    )
    unwinding_time: Scalar = Quantity(
        "s", "Time in which an integrator gives back what a full valve cannot do", 0.1
    )
    lead_time: Scalar = Quantity(
        "s",
        "How far ahead the reference speed is taken: lag of amplifier, valve and oil",
        0.1,
        minimum=0.0,
        tunable=True,
        group="Feedforward",
    )
    lead_filter_time: Scalar = Quantity("s", "Filter of the slope of the reference speed", 0.1, minimum=1e-3)
    amplifier_time: Scalar = Quantity("s", "Lag of the valve amplifier", 0.01, minimum=1e-3)
    foot_share: Scalar = Quantity(
        "1", "Opening below which the step over the dead band is rounded", 1e-3, minimum=1e-5
    )
    follow_gain: Scalar = Quantity(
        "1/s",
        "Speed at which the reference is drawn to the path, per distance",
        minimum=0.0,
        group="Reference",
    )
    follow_speed: Scalar = Quantity(
        "m/s", "Largest speed at which the reference is drawn to the path", minimum=1e-3
    )
    lever_time: Scalar = Quantity(
        "s", "Lag of the velocities wanted while no path is followed", 0.1, minimum=1e-3
    )
    blend_time: Scalar = Quantity("s", "Time over which levers and coordination take over", 0.1, minimum=1e-3)
    tracking_time: Scalar = Quantity(
        "s", "Time in which the reference follows the machine when not engaged", 0.1
    )
    singular_share: Scalar = Quantity(
        "1", "Sine of the angle between the links below which the inverse is damped", 0.1, minimum=0.0
    )
    singular_damping: Scalar = Quantity(
        "m", "Damping of the inverse where both links are in line", minimum=1e-3
    )
    swing_speed_limit: Scalar = Quantity(
        "rad/s", "Largest swing speed of the reference", minimum=1e-3, group="Limits"
    )
    boom_speed_limit: Scalar = Quantity(
        "m/s", "Largest speed of the boom piston in the reference", 0.1, minimum=1e-4
    )
    stick_speed_limit: Scalar = Quantity(
        "m/s", "Largest speed of the stick piston in the reference", 0.1, minimum=1e-4
    )
    stroke_margin: Scalar = Quantity(
        "m", "Distance from the ends of the strokes that the reference keeps", 0.01
    )
    stroke_gain: Scalar = Quantity(
        "1/s", "Largest speed of a piston towards the end of its stroke, per distance", minimum=0.1
    )
    swing_error_limit: Scalar = Quantity(
        "rad", "Lag of the swing at which the reference waits for the machine", 0.1, minimum=1e-4
    )
    piston_error_limit: Scalar = Quantity(
        "m", "Lag of a piston at which the reference waits for the machine", 0.01, minimum=1e-5
    )
    return_rate: Scalar = Quantity(
        "1/s", "Rate at which the reference comes back beyond that error", minimum=0.0
    )
