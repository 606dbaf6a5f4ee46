"""What a person reads: tables, figures, the results folder."""
