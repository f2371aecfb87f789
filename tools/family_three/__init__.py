"""The third sealed family of cases: see BRIEF.md."""
