"""Pictures and tables of results; reads results only, never the pipeline."""
