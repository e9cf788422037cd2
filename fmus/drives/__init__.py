"""Hydraulic drives: an axis is a cylinder or a motor with its lines and its valve, at one fidelity.

`drive.part` makes the FMU of a list of axes. The parts of the paper's machine are such lists: `fmus.swing`
has one motor, `fmus.boom_stick` two cylinders.
"""
