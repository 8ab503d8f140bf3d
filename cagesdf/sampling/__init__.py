"""Signed distance samples of shapes and of single parts, and the chunks that training reads (§3.4)."""
