"""Sunlight by table: what rays from one camera position see, on patches of splines that are made when they are seen."""
