"""Figures for a paper's column: readable without colour, with units on their axes, as SVG, PDF and PNG."""
