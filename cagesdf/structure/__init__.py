"""Structures of shapes: part hierarchies and programs, behind one interface."""
