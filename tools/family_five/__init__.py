"""The fifth sealed family of cases: see BRIEF.md."""
