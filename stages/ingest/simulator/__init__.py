"""Simulate drives of a spinning sensor through a procedural street, in SemanticKITTI's layout."""

from salpcc.stages.ingest.simulator.config import SimulationConfig
from salpcc.stages.ingest.simulator.scans import SimulatedScan, simulate_scans
from salpcc.stages.ingest.simulator.write import simulate_sequence

__all__ = ["SimulatedScan", "SimulationConfig", "simulate_scans", "simulate_sequence"]
