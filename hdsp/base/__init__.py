"""Common services without robots: errors, settings, files, storage, workers, compiled kernels, provenance."""
