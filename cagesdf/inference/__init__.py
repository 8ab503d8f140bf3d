"""Inference for shapes outside the training set: their codes, and what `cagesdf fit` makes of them."""
