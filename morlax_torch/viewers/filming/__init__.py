"""Films of robots: rendering, captions and video files."""
