"""A second sealed family of simulated cases: other mechanisms, other motions, other causes; see BRIEF.md."""
