"""Label runs: splits, shards, workers and progress."""
