"""The stages, from records to records and over a dataset file."""
