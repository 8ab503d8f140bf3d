"""Quality of surfaces: the metrics of docs/metrics.md and the tables made of them."""
