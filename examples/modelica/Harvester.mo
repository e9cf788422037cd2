package Harvester "The FMUs of harvester-cosim in a Modelica tool; README.md has the steps"

  package Imported "The classes that the tool made of the FMUs: the only lines to adapt"
    // OpenModelica names them <model>_me_FMU, Dymola <model>_fmu
    model Machine = harvester_me_FMU "All in one: commands in, motion out";
    model Swing = swing_me_FMU "Swing drive";
    model BoomStick = boom_stick_me_FMU "Boom and stick drives";
    model Manipulator = manipulator_me_FMU "Column, boom and stick";
    model Levers = levers_me_FMU "Plays strokes of the levers";
  end Imported;

  model OneBlock "The work cycle with harvester.fmu"
    Imported.Levers levers;
    Imported.Machine machine;
  equation
    connect(levers.swing_command, machine.swing_command);
    connect(levers.swing_command_rate, machine.swing_command_rate);
    connect(levers.boom_command, machine.boom_command);
    connect(levers.boom_command_rate, machine.boom_command_rate);
    connect(levers.stick_command, machine.stick_command);
    connect(levers.stick_command_rate, machine.stick_command_rate);
    machine.supply_pressure = 20.684e6 "Pa";
    machine.tank_pressure = 0 "Pa";
    annotation (experiment(StopTime = 42, Interval = 0.02, Tolerance = 1e-8));
  end OneBlock;

  model FourBlocks "The work cycle with the four FMUs, wired as in harvester.ssp"
    Imported.Levers levers;
    Imported.Swing swing;
    Imported.BoomStick boom_stick;
    Imported.Manipulator manipulator;
  equation
    // swing shaft
    connect(swing.swing_torque, manipulator.swing_torque);
    connect(swing.swing_torque_rate, manipulator.swing_torque_rate);
    connect(manipulator.swing_speed, swing.swing_speed);
    connect(manipulator.swing_acceleration, swing.swing_acceleration);
    // boom rod
    connect(boom_stick.boom_force, manipulator.boom_force);
    connect(boom_stick.boom_force_rate, manipulator.boom_force_rate);
    connect(manipulator.boom_position, boom_stick.boom_position);
    connect(manipulator.boom_velocity, boom_stick.boom_velocity);
    connect(manipulator.boom_acceleration, boom_stick.boom_acceleration);
    connect(manipulator.boom_holding_force, boom_stick.boom_holding_force);
    // stick rod
    connect(boom_stick.stick_force, manipulator.stick_force);
    connect(boom_stick.stick_force_rate, manipulator.stick_force_rate);
    connect(manipulator.stick_position, boom_stick.stick_position);
    connect(manipulator.stick_velocity, boom_stick.stick_velocity);
    connect(manipulator.stick_acceleration, boom_stick.stick_acceleration);
    connect(manipulator.stick_holding_force, boom_stick.stick_holding_force);
    // command levers
    connect(levers.swing_command, swing.swing_command);
    connect(levers.swing_command_rate, swing.swing_command_rate);
    connect(levers.boom_command, boom_stick.boom_command);
    connect(levers.boom_command_rate, boom_stick.boom_command_rate);
    connect(levers.stick_command, boom_stick.stick_command);
    connect(levers.stick_command_rate, boom_stick.stick_command_rate);
    // supply line: constant pressure
    swing.supply_pressure = 20.684e6 "Pa";
    swing.tank_pressure = 0 "Pa";
    boom_stick.supply_pressure = 20.684e6 "Pa";
    boom_stick.tank_pressure = 0 "Pa";
    annotation (experiment(StopTime = 42, Interval = 0.02, Tolerance = 1e-8));
  end FourBlocks;

  model Rod "A cylinder rod of manipulator.fmu as a flange: for hydraulics of your own in Modelica"
    Modelica.Mechanics.Translational.Interfaces.Flange_b flange "Moves with the piston";
    Modelica.Blocks.Interfaces.RealInput position(unit = "m") "From the FMU";
    Modelica.Blocks.Interfaces.RealInput velocity(unit = "m/s") "From the FMU";
    Modelica.Blocks.Interfaces.RealInput acceleration(unit = "m/s2") "From the FMU";
    Modelica.Blocks.Interfaces.RealOutput force(unit = "N") "To the FMU, positive extends";
  protected
    Modelica.Mechanics.Translational.Components.GeneralPositionToForceAdaptor adaptor;
  equation
    connect(position, adaptor.p);
    connect(velocity, adaptor.pder);
    connect(acceleration, adaptor.pder2);
    connect(adaptor.f, force);
    connect(adaptor.flange, flange);
  end Rod;

  annotation (uses(Modelica(version = "4.0.0")));
end Harvester;
