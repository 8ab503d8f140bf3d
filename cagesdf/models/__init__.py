"""The networks: tensors and numbers only."""
