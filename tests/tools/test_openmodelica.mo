package Tested "The machine under sources and controllers of the Modelica Standard Library"
  partial model Stock "harvester.fmu by the tool's own import, at its nominal supply"
    harvester_me_FMU machine;
    Real u[3] "commands [V] of swing, boom and stick";
  equation
    {machine.swing_command, machine.boom_command, machine.stick_command} = u;
    {machine.swing_command_rate, machine.boom_command_rate, machine.stick_command_rate} = zeros(3);
    machine.supply_pressure = 20.684e6;
    machine.supply_pressure_rate = 0;
    machine.tank_pressure = 0;
    machine.tank_pressure_rate = 0;
    machine.load_sensing_pressure = 0;
    machine.load_sensing_pressure_rate = 0;
    machine.payload_mass = 0;
    machine.oil_temperature = 333.15;
  end Stock;

  package Sources "All three commands at once, from 0.5 s on"
    partial model Driven
      extends Stock;
      parameter Real c[3] = {2.5, 3.0, -3.0} "amplitudes [V]";
      parameter Real moving = 0 "1: the commands are c until 0.5 s, not 0";
    end Driven;

    model Constant
      extends Driven;
      Modelica.Blocks.Sources.Constant s[3](k = c);
    equation
      u = s.y;
    end Constant;

    model Step
      extends Driven;
      Modelica.Blocks.Sources.Step s[3](height = c, offset = moving * c, each startTime = 0.5);
    equation
      u = s.y;
    end Step;

    model Filtered
      extends Driven;
      Modelica.Blocks.Sources.Step s[3](height = c, offset = moving * c, each startTime = 0.5);
      Modelica.Blocks.Continuous.FirstOrder f[3](each T = 0.05, each initType = Modelica.Blocks.Types.Init.SteadyState);
    equation
      connect(s.y, f.u);
      u = f.y;
    end Filtered;

    model Ramp
      extends Driven;
      Modelica.Blocks.Sources.Ramp s[3](height = c, offset = moving * c, each startTime = 0.5, each duration = 1);
    equation
      u = s.y;
    end Ramp;

    model Sine
      extends Driven;
      Modelica.Blocks.Sources.Sine s[3](amplitude = c, offset = moving * c, each startTime = 0.5, each f = 0.5);
    equation
      u = s.y;
    end Sine;

    model Trapezoid
      extends Driven;
      Modelica.Blocks.Sources.Trapezoid s[3](amplitude = c, offset = moving * c, each startTime = 0.5,
        each rising = 0.5, each width = 0.5, each falling = 0.5, each period = 2);
    equation
      u = s.y;
    end Trapezoid;

    model Pulse
      extends Driven;
      Modelica.Blocks.Sources.Pulse s[3](amplitude = c, offset = moving * c, each startTime = 0.5, each period = 1);
    equation
      u = s.y;
    end Pulse;

    model Table
      extends Driven;
      Modelica.Blocks.Sources.CombiTimeTable s(
        table = [0, 0; 0.5, 0; 1.5, 1; 2.5, 1; 3.2, -0.5; 4, 0]);
    equation
      u = c * (moving + s.y[1]);
    end Table;
  end Sources;

  model Levers "One by connect, one by a modifier, and one by neither"
    Harvester.WithFlanges.Swing drive(swing_command = 2);
    Harvester.FMUs.BoomStick cylinders;
    Modelica.Blocks.Sources.Ramp lever(height = 3, duration = 4);
    Real u[3] = {drive.swing_command, cylinders.boom_command, cylinders.stick_command};
    Real inside = drive.block_.swing_command;
  equation
    connect(lever.y, cylinders.boom_command);
    {cylinders.boom_position, cylinders.boom_velocity, cylinders.stick_position, cylinders.stick_velocity} = zeros(4);
    {cylinders.boom_holding_force, cylinders.stick_holding_force} = zeros(2);
  end Levers;

  package Loops "The boom follows a ramp of its angle"
    partial model Boom
      Modelica.Blocks.Sources.Ramp target(height = 0.3, offset = 0.2, startTime = 0.5, duration = 2);
      Modelica.Blocks.Continuous.FirstOrder amplifier(T = 0.01, initType = Modelica.Blocks.Types.Init.InitialOutput);
    end Boom;

    model P "The delay of an amplifier keeps the feedback out of the imported function's inputs"
      extends Stock;
      extends Boom;
    equation
      amplifier.u = 20 * (target.y - machine.boom_angle);
      u = {0, amplifier.y, 0};
    end P;

    model PI
      extends Stock;
      extends Boom;
      Modelica.Blocks.Continuous.PI pi(k = 20, T = 2);
    equation
      pi.u = target.y - machine.boom_angle;
      connect(pi.y, amplifier.u);
      u = {0, amplifier.y, 0};
    end PI;

    model LimPID
      extends Stock;
      extends Boom;
      Modelica.Blocks.Continuous.LimPID pid(k = 20, Ti = 2, Td = 0.05, yMax = 6);
    equation
      connect(target.y, pid.u_s);
      connect(machine.boom_angle, pid.u_m);
      connect(pid.y, amplifier.u);
      u = {0, amplifier.y, 0};
    end LimPID;

    partial model Parts "The parts by connect, and no delay: their angles depend on no input"
      Modelica.Blocks.Sources.Ramp target(height = 0.3, offset = 0.2, startTime = 0.5, duration = 2);
      Modelica.Blocks.Interfaces.RealOutput command(unit = "V");
      Harvester.FMUs.Supply supply;
      Harvester.FMUs.Swing swing(use_supply_pressure_in = true, use_tank_pressure_in = true);
      Harvester.FMUs.BoomStick boom_stick(use_supply_pressure_in = true, use_tank_pressure_in = true);
      Harvester.FMUs.Manipulator manipulator;
    equation
      connect(command, boom_stick.boom_command);  // the other levers are 0
      connect(swing.swing_torque, manipulator.swing_torque);
      connect(manipulator.swing_speed, swing.swing_speed);
      connect(boom_stick.boom_force, manipulator.boom_force);
      connect(manipulator.boom_position, boom_stick.boom_position);
      connect(manipulator.boom_velocity, boom_stick.boom_velocity);
      connect(boom_stick.stick_force, manipulator.stick_force);
      connect(manipulator.stick_position, boom_stick.stick_position);
      connect(manipulator.stick_velocity, boom_stick.stick_velocity);
      connect(manipulator.boom_holding_force, boom_stick.boom_holding_force);
      connect(manipulator.stick_holding_force, boom_stick.stick_holding_force);
      connect(supply.supply_pressure, swing.supply_pressure);
      connect(supply.tank_pressure, swing.tank_pressure);
      connect(supply.supply_pressure, boom_stick.supply_pressure);
      connect(supply.tank_pressure, boom_stick.tank_pressure);
      connect(swing.swing_load_pressure, supply.swing_load_pressure);
      connect(boom_stick.boom_stick_load_pressure, supply.boom_stick_load_pressure);
      connect(swing.supply_flow, supply.supply_flow_swing);
      connect(swing.return_flow, supply.return_flow_swing);
      connect(boom_stick.supply_flow, supply.supply_flow_boom_stick);
      connect(boom_stick.return_flow, supply.return_flow_boom_stick);
    end Parts;

    model PartsP
      extends Parts;
    equation
      command = 20 * (target.y - manipulator.boom_angle);
    end PartsP;

    model PartsLimPID
      extends Parts;
      Modelica.Blocks.Continuous.LimPID pid(k = 20, Ti = 2, Td = 0.05, yMax = 6);
    equation
      connect(target.y, pid.u_s);
      connect(manipulator.boom_angle, pid.u_m);
      connect(pid.y, command);
    end PartsLimPID;

    model Control "Six parts in the system of the tip's controller"
      extends Harvester.Systems.HarvesterControl(
        controller_engaged = 1, controller_radial_velocity = 0.3 * sin(2 * time), controller_swing_velocity = 0.1);
    end Control;
  end Loops;
end Tested;
