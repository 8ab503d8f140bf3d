"""The page that shows a run: tables beside the paper's, pictures and loss curves."""
