"""What was found, as text, Markdown, HTML and JSON."""
