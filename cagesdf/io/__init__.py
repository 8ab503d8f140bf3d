"""Artefacts on disk, one file per kind. Only these files touch pyarrow."""
