"""Neural implicit shapes with explicit bounding cuboids."""
