"""The dataset file: its schema, its columns, reading and writing."""
