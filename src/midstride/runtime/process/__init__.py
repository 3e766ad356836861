"""The processes of components: started, registered, reached by commands, and ended."""
