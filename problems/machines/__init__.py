"""Machines with published constants, their pictures, and parts that their problems share."""
