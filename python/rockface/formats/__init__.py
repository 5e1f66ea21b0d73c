"""Readers of the files artefacts are kept in; each needs numpy only."""
