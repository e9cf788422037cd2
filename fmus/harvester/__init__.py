"""The whole machine as one block."""

from fmus.harvester.model import HARVESTER, whole

__all__ = ["HARVESTER", "whole"]
