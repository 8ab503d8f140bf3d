"""Foreign file formats, one file each: raw shapes in, raw shapes out."""
