"""What the annotations of other tools in an SSP say about the coupling of its components.

SSP has no place for the communication step, so each tool has its own. What is said is followed, or the run is
refused until the user says how to couple: a run with another step than the file's would look like its result.

OMSimulator   org.openmodelica: FixedStepMaster, VariableStepMaster, or their attributes; Jacobi, held inputs
a draft       SimulationInformation directly in a System, as drafts of SSP had it: as that of OMSimulator
libcosim      com.opensimulationplatform, org.open-simulation-platform: FixedStepAlgorithm; as before
Vico          com.github.ntnu-ihb.vico: FixedStepAlgorithm, FixedStepMaster; Jacobi, held inputs
OpenMCx       com.avl.model.connect.ssp.task: Task; Gauss-Seidel if it is sequential, else Jacobi
FMIGo, Ecos   arguments, order of execution, kinematic constraints, scenarios: refused
"""

from orchestrator.system.vendors.reading import read_vendors

__all__ = ["read_vendors"]
