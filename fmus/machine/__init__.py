"""The machine: its parts, systems, and what a Modelica package of them leaves constant."""

# inputs that most models leave constant
CONSTANT_INPUTS = ("supply_pressure", "tank_pressure", "oil_temperature", "payload_mass")
LEVERS = ("swing_command", "boom_command", "stick_command")  # 0 where nothing is connected, in Modelica
