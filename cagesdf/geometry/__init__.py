"""Triangle meshes: distances to them, their repair into closed solids, unions, resizing."""
