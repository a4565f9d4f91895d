"""Drawings of studies of policies and their gradients."""
