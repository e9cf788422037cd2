"""The machine: its parts, systems, and what a Modelica package of them leaves constant."""

CONSTANT_INPUTS = ("supply_pressure", "tank_pressure", "payload_mass")  # that most models leave constant
LEVERS = ("swing_command", "boom_command", "stick_command")  # 0 where nothing is connected, in Modelica
