"""The sixth sealed family of cases: see BRIEF.md."""
