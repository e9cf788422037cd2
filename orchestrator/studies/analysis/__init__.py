"""What the runs of a study say: summary of each output, failed runs, which factors move what."""

from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.analysis.results import Analysis, Effect, Estimate, Finding, Sensitivity
from orchestrator.studies.analysis.wording import sentences

__all__ = ["Analysis", "Effect", "Estimate", "Finding", "Sensitivity", "analyse", "sentences"]
