"""Closed loops of ``ocp mpc``: what is stored of them, how they are drawn, and their film."""
