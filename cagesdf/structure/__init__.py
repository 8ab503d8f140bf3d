"""What holds a shape's parts together, behind one interface."""
