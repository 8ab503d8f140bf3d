"""What a surface is worth: the metrics of docs/metrics.md and the tables made of them."""
