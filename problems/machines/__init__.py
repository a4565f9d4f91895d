"""Machines with published constants, their pictures, and parts shared by their problems."""
