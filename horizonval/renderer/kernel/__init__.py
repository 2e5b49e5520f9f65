"""The deterministic march: rays, cells, coverage, surfaces, integration along one ray."""
