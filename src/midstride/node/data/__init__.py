"""The data thread of a component: it runs the author's code, one call after another."""

PUBLIC = "Admission CAUGHT Call DataExecutor FunctionalityRunner Hold InfoSet ModeSwitch format_error within"
