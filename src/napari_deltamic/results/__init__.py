"""What is made of a result: tables, files for other tools, pictures, pages."""
