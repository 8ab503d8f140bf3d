"""The Python API: trained runs, shapes to edit, distances and checks. `import cagesdf` gives the names.

runs.py       a trained run: its shapes, new ones, and those of other files
shapes.py     a shape with a surface: edited, or fitted to files
sources.py    shapes of files or meshes: closed parts, whether they can be used, signed distances
display.py    shapes in a notebook
"""
