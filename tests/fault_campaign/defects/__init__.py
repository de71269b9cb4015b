"""Deliberate defects of the service and of what it talks to; importing this package registers those of every file."""

from tests.fault_campaign.defects import gate_and_pipeline, makers, native, recording, service_and_link
from tests.fault_campaign.defects.table import DEFECTS, Defect

__all__ = ["DEFECTS", "Defect", "gate_and_pipeline", "makers", "native", "recording", "service_and_link"]
