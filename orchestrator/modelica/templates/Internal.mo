package Internal "Calls of FMUs by external functions"
  extends Modelica.Icons.InternalPackage;

  class Instance "An FMU with the values of its parameters"
    extends ExternalObject;

    function constructor
      extends Modelica.Icons.Function;
      input String name "Name of the block for messages";
      input String folder "Folder of the unpacked FMU";
      input String model_identifier;
      input String guid "GUID of the model description";
      input Integer real_reference[:] "Value references of parameters";
      input Real real_value[size(real_reference, 1)];
      input Integer integer_reference[:];
      input Integer integer_value[size(integer_reference, 1)];
      input Integer boolean_reference[:];
      input Integer boolean_value[size(boolean_reference, 1)] "1 and 0, because tools differ in how they pass arrays of Boolean";
      input Integer string_reference[:];
      input String string_value[size(string_reference, 1)];
      output Instance fmu;
      external "C" fmu = @PACKAGE@_fmu_new(name, folder, model_identifier, guid,
        real_reference, size(real_reference, 1), real_value,
        integer_reference, size(integer_reference, 1), integer_value,
        boolean_reference, size(boolean_reference, 1), boolean_value,
        string_reference, size(string_reference, 1), string_value)
        annotation(Include = "#include \"@PACKAGE@.h\"", IncludeDirectory = "modelica://@PACKAGE@/Resources/Include");
    end constructor;

    function destructor
      extends Modelica.Icons.Function;
      input Instance fmu;
      external "C" @PACKAGE@_fmu_free(fmu)
        annotation(Include = "#include \"@PACKAGE@.h\"", IncludeDirectory = "modelica://@PACKAGE@/Resources/Include");
    end destructor;
  end Instance;

  function start "Initial states"
    extends Modelica.Icons.Function;
    input Instance fmu;
    input Real t;
    input Integer u_reference[:];
    input Real u[size(u_reference, 1)];
    input Integer x_reference[:];
    output Real x[size(x_reference, 1)];
    external "C" @PACKAGE@_fmu_start(fmu, t, u_reference, size(u_reference, 1), u, x_reference, size(x_reference, 1), x)
      annotation(Include = "#include \"@PACKAGE@.h\"", IncludeDirectory = "modelica://@PACKAGE@/Resources/Include");
  end start;

  function derivatives "Time derivatives of the states"
    extends Modelica.Icons.Function;
    input Instance fmu;
    input Real t;
    input Real x[:];
    input Integer u_reference[:];
    input Real u[size(u_reference, 1)];
    output Real dx[size(x, 1)];
    external "C" @PACKAGE@_fmu_derivatives(fmu, t, x, size(x, 1), u_reference, size(u_reference, 1), u, dx)
      annotation(Include = "#include \"@PACKAGE@.h\"", IncludeDirectory = "modelica://@PACKAGE@/Resources/Include");
  end derivatives;

  function outputs "Outputs with the same dependencies on inputs"
    extends Modelica.Icons.Function;
    input Instance fmu;
    input Real t;
    input Real x[:];
    input Integer u_reference[:];
    input Real u[size(u_reference, 1)];
    input Integer y_reference[:];
    output Real y[size(y_reference, 1)];
    external "C" @PACKAGE@_fmu_outputs(fmu, t, x, size(x, 1), u_reference, size(u_reference, 1), u, y_reference, size(y_reference, 1), y)
      annotation(Include = "#include \"@PACKAGE@.h\"", IncludeDirectory = "modelica://@PACKAGE@/Resources/Include");
  end outputs;

  function event "Time of the next time event"
    extends Modelica.Icons.Function;
    input Instance fmu;
    input Real t;
    input Real x[:];
    input Integer u_reference[:];
    input Real u[size(u_reference, 1)];
    output Real next;
    external "C" next = @PACKAGE@_fmu_event(fmu, t, x, size(x, 1), u_reference, size(u_reference, 1), u)
      annotation(Include = "#include \"@PACKAGE@.h\"", IncludeDirectory = "modelica://@PACKAGE@/Resources/Include");
  end event;
end Internal;
