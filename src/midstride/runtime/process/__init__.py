"""The processes of components: started, registered, reached by commands, and ended."""

PUBLIC = (
    "ComponentClient ComponentEvent Disconnected LastKnown Launcher Process ProcessInfo REPORTED Reaper "
    "adopting_orphans begin_run end_orphans environment_value find have_answer killed_in_words launch_of mark_of "
    "maybe_done process_info raise_limit reaper room_for_a_start run_begun shorten spawn stop_times tail "
    "text_of_latest_run"
)
