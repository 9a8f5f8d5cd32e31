"""Motions and equilibria as functions of parameters: values without set-up, and derivatives."""
