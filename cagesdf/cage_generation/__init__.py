"""New structures and their cages: what a shape is before it has a surface (§4.4)."""
