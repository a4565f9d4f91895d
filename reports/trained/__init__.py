"""Trained policies for people: the live curve, tables, figures and pages."""
