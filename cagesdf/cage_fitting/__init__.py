"""Cuboids that bound a shape's parts (§3.2): free of each other, or as a program ties them together."""
