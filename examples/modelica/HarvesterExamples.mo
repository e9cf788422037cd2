package HarvesterExamples "The FMUs of harvester-cosim in Modelica; README.md has the steps"
  extends Modelica.Icons.ExamplesPackage;

  package Imported "harvester.fmu and operator_input.fmu by the tool's own import"
    extends Modelica.Icons.ExamplesPackage;

    // the classes that the tool made of the FMUs: the only lines to adapt
    // OpenModelica names them <model>_me_FMU, Dymola <model>_fmu
    model Machine = harvester_me_FMU "The whole machine: commands in, motion out";
    model OperatorInput = operator_input_me_FMU "Plays strokes of the levers";

    model OneBlock "The work cycle"
      extends Modelica.Icons.Example;
      OperatorInput operator_input;
      Machine machine;
    equation
      connect(operator_input.swing_command, machine.swing_command);
      connect(operator_input.swing_command_rate, machine.swing_command_rate);
      connect(operator_input.boom_command, machine.boom_command);
      connect(operator_input.boom_command_rate, machine.boom_command_rate);
      connect(operator_input.stick_command, machine.stick_command);
      connect(operator_input.stick_command_rate, machine.stick_command_rate);
      connect(operator_input.payload_mass, machine.payload_mass);
      // an open input is zero in the tool's class, not its start value
      machine.supply_pressure = 20.684e6 "Pa";
      machine.supply_pressure_rate = 0 "Pa/s";
      machine.tank_pressure = 0 "Pa";
      machine.tank_pressure_rate = 0 "Pa/s";
      machine.load_sensing_pressure = 0 "Pa";
      machine.load_sensing_pressure_rate = 0 "Pa/s";
      machine.oil_temperature = 333.15 "K";
      annotation(experiment(StopTime = 42, Interval = 0.02, Tolerance = 1e-8));
    end OneBlock;

    model OtherPose "The same from another pose"
      extends OneBlock(machine(
        initial_swing_angle = 0.3, initial_boom_angle = 0.5, initial_stick_angle = -1.2));
      annotation(experiment(StopTime = 42, Interval = 0.02, Tolerance = 1e-8));
    end OtherPose;

    model HeavyHead "The same with a heavier head"
      extends OneBlock(machine(head_mass = 600));
      annotation(experiment(StopTime = 42, Interval = 0.02, Tolerance = 1e-8));
    end HeavyHead;
  end Imported;

  package Parts "The parts, from the package that harvester modelica writes"
    extends Modelica.Icons.ExamplesPackage;

    model Signals "The work cycle, wired as in harvester.ssp"
      extends Harvester.Systems.Harvester;
      annotation(experiment(StopTime = 42, Interval = 0.02, Tolerance = 1e-8));
    end Signals;

    model OtherPose "The same from another pose"
      extends Harvester.Systems.Harvester(manipulator(
        initial_swing_angle = 0.3, initial_boom_angle = 0.5, initial_stick_angle = -1.2));
      annotation(experiment(StopTime = 42, Interval = 0.02, Tolerance = 1e-8));
    end OtherPose;

    model HeavyHead "The same with a heavier head"
      extends Harvester.Systems.Harvester(manipulator(head_mass = 600));
      annotation(experiment(StopTime = 42, Interval = 0.02, Tolerance = 1e-8));
    end HeavyHead;

    model Flanges "The work cycle, connected at rods and shaft"
      extends Modelica.Icons.Example;
      Harvester.FMUs.OperatorInput operator_input;
      Harvester.WithFlanges.Swing swing;
      Harvester.WithFlanges.BoomStick boom_stick;
      Harvester.WithFlanges.Manipulator arm;
    equation
      connect(operator_input.swing_command, swing.swing_command);
      connect(operator_input.boom_command, boom_stick.boom_command);
      connect(operator_input.stick_command, boom_stick.stick_command);
      connect(swing.swing, arm.swing);
      connect(boom_stick.boom, arm.boom);
      connect(boom_stick.stick, arm.stick);
      // pressures at the start
      connect(arm.boom_holding_force, boom_stick.boom_holding_force);
      connect(arm.stick_holding_force, boom_stick.stick_holding_force);
      annotation(experiment(StopTime = 42, Interval = 0.02, Tolerance = 1e-8));
    end Flanges;

    model HeldByForces "Constant forces at the rods hold the arm for a second"
      extends Modelica.Icons.Example;
      Harvester.WithFlanges.Manipulator arm;
      Modelica.Mechanics.Translational.Sources.ConstantForce boom(f_constant = 86714.339364 "N, pushes");
      Modelica.Mechanics.Translational.Sources.ConstantForce stick(f_constant = -10633.830375 "N, pulls");
      Modelica.Mechanics.Rotational.Sources.ConstantTorque swing(tau_constant = 0);
    equation
      connect(boom.flange, arm.boom);
      connect(stick.flange, arm.stick);
      connect(swing.flange, arm.swing);
      annotation(experiment(StopTime = 1, Interval = 0.01, Tolerance = 1e-8));
    end HeldByForces;

    model Cylinder "Two chambers of oil: hydraulics of your own"
      Modelica.Mechanics.Translational.Interfaces.Flange_b rod;
      Modelica.Blocks.Interfaces.RealInput holding_force(unit = "N") "Used at the start";
      parameter Real head_area(unit = "m2") = 0.01131;
      parameter Real rod_area(unit = "m2") = 0.00746;
      parameter Real stroke(unit = "m") = 0.61;
      parameter Real bulk_modulus(unit = "Pa") = 1.6e9;
      parameter Real preload(unit = "Pa") = 1.5e6 "Of the rod side at the start";
      Real inflow(unit = "m3/s") "Into the head side; rod_area / head_area of it leaves the rod side";
      Real head_pressure(unit = "Pa"), rod_pressure(unit = "Pa");
      Real v(unit = "m/s") = der(rod.s);
    initial equation
      rod_pressure = preload;
      head_area * head_pressure - rod_area * rod_pressure = holding_force;
    equation
      der(head_pressure) = bulk_modulus * (inflow - head_area * v) / (3e-4 + head_area * rod.s);
      der(rod_pressure) = bulk_modulus * rod_area * (v - inflow / head_area) / (3e-4 + rod_area * (stroke - rod.s));
      rod.f = -(head_area * head_pressure - rod_area * rod_pressure);
    end Cylinder;

    model OwnHydraulics "Cylinders that are written in Modelica: oil raises the boom, the stick is locked"
      extends Modelica.Icons.Example;
      Cylinder boom;
      Cylinder stick(head_area = 0.01039, rod_area = 0.00654, stroke = 0.725);
      Harvester.WithFlanges.Manipulator arm;
      Modelica.Mechanics.Rotational.Sources.ConstantTorque swing(tau_constant = 0);
    equation
      connect(boom.rod, arm.boom);
      connect(stick.rod, arm.stick);
      connect(swing.flange, arm.swing);
      connect(arm.boom_holding_force, boom.holding_force);
      connect(arm.stick_holding_force, stick.holding_force);
      boom.inflow = 1e-3 * max(0, min(time - 0.2, 1));
      stick.inflow = 0;
      annotation(experiment(StopTime = 2, Interval = 0.01, Tolerance = 1e-8));
    end OwnHydraulics;
  end Parts;

  annotation(uses(Modelica(version = "4.0.0"), Harvester));
end HarvesterExamples;
