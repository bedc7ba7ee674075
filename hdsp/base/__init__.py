"""Common services without robots.

- `errors`: user errors
- `settings`, `yaml_files`: typed settings from YAML, JSON and mappings; `messages`: values in messages
- `files`, `downloads`, `storage`: whole-or-absent files, published data files, local folders and object stores
- `workers`: worker processes, on this machine or a cluster
- `gradual`: computations in short steps, for time limits
- `jit`, `kernel_cache`: compiled kernels and their cache on disk
- `provenance`, `definitions`: fingerprints of the code behind a result
- `conformance`: contracts for checks of user implementations
"""

from hdsp.base.conformance import ConformanceError, Contract
from hdsp.base.downloads import data_folder, fetch, verify
from hdsp.base.errors import InputError, RefinementError
from hdsp.base.files import existing_file, replacing, writable_file
from hdsp.base.gradual import Gradual, Steps, finished
from hdsp.base.jit import njit
from hdsp.base.provenance import code_fingerprint, reached_code
from hdsp.base.settings import checked, load_settings
from hdsp.base.storage import Folder, Place, open_folder
from hdsp.base.workers import ClusterSettings, connected
from hdsp.base.yaml_files import Document, parse_yaml, read_json, read_yaml

__all__ = [
    "ClusterSettings",
    "ConformanceError",
    "Contract",
    "Document",
    "Folder",
    "Gradual",
    "InputError",
    "Place",
    "RefinementError",
    "Steps",
    "checked",
    "code_fingerprint",
    "connected",
    "data_folder",
    "existing_file",
    "fetch",
    "finished",
    "load_settings",
    "njit",
    "open_folder",
    "parse_yaml",
    "reached_code",
    "read_json",
    "read_yaml",
    "replacing",
    "verify",
    "writable_file",
]
