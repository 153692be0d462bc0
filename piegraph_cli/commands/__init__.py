"""The program: options from settings, output, and one module per group of commands. Nothing heavy is imported here."""
