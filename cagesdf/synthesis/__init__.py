"""Procedural chairs, tables and vases: cages first, then surfaces that fill them."""
