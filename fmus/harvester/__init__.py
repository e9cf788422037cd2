"""The whole machine as one block."""

from fmus.harvester.model import HARVESTER

__all__ = ["HARVESTER"]
