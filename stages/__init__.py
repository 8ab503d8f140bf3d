"""The stages, one thin file each. `dvc.yaml` says where their files lie."""
