"""Stages in dvc.yaml, one thin module each: read the configuration, call hdsp, write outputs and metrics."""
