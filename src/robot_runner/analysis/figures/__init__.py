"""Figures for a paper's column: told apart without colour, with units on their axes, as SVG, PDF and PNG."""
