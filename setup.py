"""Packages of the wheel. Names that `pyproject.toml` cannot give: the pipeline is installed as `hdsp_pipeline`.

The checkout has the short name `pipeline`; beside other installed packages, this name could collide.
"""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["hdsp*"]), "hdsp_pipeline", "hdsp_pipeline.conf"],
    package_dir={"hdsp_pipeline": "pipeline", "hdsp_pipeline.conf": "conf"},
)
