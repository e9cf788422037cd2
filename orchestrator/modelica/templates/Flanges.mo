package Flanges "From signals of an FMU to mechanical flanges and back"
  extends Modelica.Icons.InterfacesPackage;

  model MovedRod "A flange that moves as signals say, and gives the force on it"
    Modelica.Mechanics.Translational.Interfaces.Flange_a flange "Moves with the rod; what pushes on it is positive";
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
    force = -adaptor.f "the adaptor gives the force on the other side";
    connect(adaptor.flange, flange);
  end MovedRod;

  model PushedRod "A flange with a force that a signal gives, and the motion that it has"
    Modelica.Mechanics.Translational.Interfaces.Flange_b flange "The force pushes what is connected here";
    Modelica.Blocks.Interfaces.RealInput force(unit = "N") "Positive in the direction of the position";
    Modelica.Blocks.Interfaces.RealOutput position(unit = "m");
    Modelica.Blocks.Interfaces.RealOutput velocity(unit = "m/s");
  equation
    flange.f = -force;
    position = flange.s;
    velocity = der(flange.s);
  end PushedRod;

  model MovedShaft "A flange that turns as signals say, and gives the torque on it"
    Modelica.Mechanics.Rotational.Interfaces.Flange_a flange "Turns with the shaft; what drives it is positive";
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
    torque = -adaptor.f "the adaptor gives the torque on the other side";
    connect(adaptor.flange, flange);
  end MovedShaft;

  model DrivenShaft "A flange with a torque that a signal gives, and the speed that it has"
    Modelica.Mechanics.Rotational.Interfaces.Flange_b flange "The torque drives what is connected here";
    Modelica.Blocks.Interfaces.RealInput torque(unit = "N.m") "Positive in the direction of the angle";
    Modelica.Blocks.Interfaces.RealOutput speed(unit = "rad/s");
  equation
    flange.tau = -torque;
    speed = der(flange.phi);
  end DrivenShaft;
end Flanges;
