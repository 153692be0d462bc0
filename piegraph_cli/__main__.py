"""`python -m piegraph_cli`: the program where `piegraph` is not on the PATH."""

from piegraph_cli.commands.program import main

if __name__ == "__main__":  # worker processes import this file under another name
    main()
