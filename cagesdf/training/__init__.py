"""Batches, losses, the loop and its checkpoints."""
