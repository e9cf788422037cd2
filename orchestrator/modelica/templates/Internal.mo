package Internal "Functions of an FMU"
  extends Modelica.Icons.InternalPackage;

  class Instance "An FMU with its parameters"
    extends ExternalObject;

    function constructor
      extends Modelica.Icons.Function;
      input String folder "Of the unpacked FMU";
      input String name "Model identifier";
      input String guid "Of its model description";
      input Integer parameter_reference[:] "Value references";
      input Real parameter_value[size(parameter_reference, 1)];
      output Instance fmu;
      external "C" fmu = fmu_new(folder, name, guid, parameter_reference, size(parameter_reference, 1), parameter_value)
        annotation(Include = "#include \"fmu.h\"", IncludeDirectory = "modelica://@PACKAGE@/Resources/Include");
    end constructor;

    function destructor
      extends Modelica.Icons.Function;
      input Instance fmu;
      external "C" fmu_free(fmu)
        annotation(Include = "#include \"fmu.h\"", IncludeDirectory = "modelica://@PACKAGE@/Resources/Include");
    end destructor;
  end Instance;

  function start "States at the start"
    extends Modelica.Icons.Function;
    input Instance fmu;
    input Real t;
    input Integer u_reference[:];
    input Real u[size(u_reference, 1)];
    input Integer x_reference[:];
    output Real x[size(x_reference, 1)];
    external "C" fmu_start(fmu, t, u_reference, size(u_reference, 1), u, x_reference, size(x_reference, 1), x)
      annotation(Include = "#include \"fmu.h\"", IncludeDirectory = "modelica://@PACKAGE@/Resources/Include");
  end start;

  function derivatives "Time derivatives of the states"
    extends Modelica.Icons.Function;
    input Instance fmu;
    input Real t;
    input Real x[:];
    input Integer u_reference[:];
    input Real u[size(u_reference, 1)];
    output Real dx[size(x, 1)];
    external "C" fmu_derivatives(fmu, t, x, size(x, 1), u_reference, size(u_reference, 1), u, dx)
      annotation(Include = "#include \"fmu.h\"", IncludeDirectory = "modelica://@PACKAGE@/Resources/Include");
  end derivatives;

  function outputs "Outputs that depend on the same inputs"
    extends Modelica.Icons.Function;
    input Instance fmu;
    input Real t;
    input Real x[:];
    input Integer u_reference[:];
    input Real u[size(u_reference, 1)];
    input Integer y_reference[:];
    output Real y[size(y_reference, 1)];
    external "C" fmu_outputs(fmu, t, x, size(x, 1), u_reference, size(u_reference, 1), u, y_reference, size(y_reference, 1), y)
      annotation(Include = "#include \"fmu.h\"", IncludeDirectory = "modelica://@PACKAGE@/Resources/Include");
  end outputs;

  function event "The next time at which a derivative jumps"
    extends Modelica.Icons.Function;
    input Instance fmu;
    input Real t;
    input Real x[:];
    output Real next;
    external "C" next = fmu_event(fmu, t, x, size(x, 1))
      annotation(Include = "#include \"fmu.h\"", IncludeDirectory = "modelica://@PACKAGE@/Resources/Include");
  end event;
end Internal;
