"""What the TOML files may say: every key with its unit, and the JSON Schema."""
