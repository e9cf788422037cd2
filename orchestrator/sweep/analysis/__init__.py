"""What the runs of a study say: summary of each output, failed runs, which factors move what."""

from orchestrator.sweep.analysis.analyse import analyse
from orchestrator.sweep.analysis.outcome import Analysis, Effect, Estimate, Finding, Sensitivity
from orchestrator.sweep.analysis.wording import sentences

__all__ = ["Analysis", "Effect", "Estimate", "Finding", "Sensitivity", "analyse", "sentences"]
