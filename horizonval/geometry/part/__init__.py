"""Parts of the spacecraft as triangles."""
