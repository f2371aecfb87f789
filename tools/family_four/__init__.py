"""The fourth sealed family of cases: see BRIEF.md."""
