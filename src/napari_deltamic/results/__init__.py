"""What runs leave behind: reports, tables, pictures, sessions, files of a scene."""
