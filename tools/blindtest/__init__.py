"""Diagnoses checked on data whose effect is withheld."""
