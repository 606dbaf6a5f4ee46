"""What a person writes: scenarios, filters, drives and sweeps as frozen, validated models."""
