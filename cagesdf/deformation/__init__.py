"""Deformation sequences (§3.3): which shapes match, and how cages and surfaces go from one to the other."""
