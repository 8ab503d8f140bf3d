"""Shapes changed by hand: operations on cuboids, programs and codes, and scripts of them."""
