"""Tracks of other programs for captures of fastflowgs."""
