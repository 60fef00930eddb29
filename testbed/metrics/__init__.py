"""Figures of merit of a track against the truth. One file a metric."""
