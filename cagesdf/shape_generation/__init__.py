"""New shapes from a trained network and new cages: codes, surfaces, and whether they stand (§4.4)."""
