package Flanges "Adapters between signals of an FMU and mechanical flanges"
  extends Modelica.Icons.InterfacesPackage;

  model MovedRod "Flange with a motion from input signals; the force on it is an output"
    Modelica.Mechanics.Translational.Interfaces.Flange_a flange "Moves with the rod; a force that pushes it is positive";
    Modelica.Blocks.Interfaces.RealInput position(unit = "m");
    Modelica.Blocks.Interfaces.RealInput velocity(unit = "m/s");
    Modelica.Blocks.Interfaces.RealInput acceleration(unit = "m/s2");
    Modelica.Blocks.Interfaces.RealOutput force(unit = "N") "On the rod, positive in the direction of the position";
  protected
    Modelica.Mechanics.Translational.Components.GeneralPositionToForceAdaptor adaptor;
  equation
    connect(position, adaptor.p);
    connect(velocity, adaptor.pder);
    connect(acceleration, adaptor.pder2);
    force = -adaptor.f "the adaptor returns the force on the other side";
    connect(adaptor.flange, flange);
  end MovedRod;

  model PushedRod "Flange with a force from an input signal; its motion is an output"
    Modelica.Mechanics.Translational.Interfaces.Flange_b flange "The force acts on the connected component";
    Modelica.Blocks.Interfaces.RealInput force(unit = "N") "Positive in the direction of the position";
    Modelica.Blocks.Interfaces.RealOutput position(unit = "m");
    Modelica.Blocks.Interfaces.RealOutput velocity(unit = "m/s");
  equation
    flange.f = -force;
    position = flange.s;
    velocity = der(flange.s);
  end PushedRod;

  model MovedShaft "Flange with a rotation from input signals; the torque on it is an output"
    Modelica.Mechanics.Rotational.Interfaces.Flange_a flange "Turns with the shaft; a torque that drives it is positive";
    Modelica.Blocks.Interfaces.RealInput angle(unit = "rad");
    Modelica.Blocks.Interfaces.RealInput speed(unit = "rad/s");
    Modelica.Blocks.Interfaces.RealInput acceleration(unit = "rad/s2");
    Modelica.Blocks.Interfaces.RealOutput torque(unit = "N.m") "On the shaft, positive in the direction of the angle";
  protected
    Modelica.Mechanics.Rotational.Components.GeneralAngleToTorqueAdaptor adaptor;
  equation
    connect(angle, adaptor.p);
    connect(speed, adaptor.pder);
    connect(acceleration, adaptor.pder2);
    torque = -adaptor.f "the adaptor returns the torque on the other side";
    connect(adaptor.flange, flange);
  end MovedShaft;

  model DrivenShaft "Flange with a torque from an input signal; its speed is an output"
    Modelica.Mechanics.Rotational.Interfaces.Flange_b flange "The torque acts on the connected component";
    Modelica.Blocks.Interfaces.RealInput torque(unit = "N.m") "Positive in the direction of the angle";
    Modelica.Blocks.Interfaces.RealOutput speed(unit = "rad/s");
  equation
    flange.tau = -torque;
    speed = der(flange.phi);
  end DrivenShaft;
end Flanges;
