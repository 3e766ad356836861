"""The processes of components: started, registered, reached by commands, and ended."""

PUBLIC = (
    "ComponentClient ComponentEvent Disconnected LastKnown Launcher Memory Process ProcessInfo REOPEN_INTERVAL "
    "REPORTED Reaper SHARED adopting_orphans begin_run end_orphans environment_value find free_memory have_answer "
    "killed_in_words launch_of mark_of maybe_done memory_of needed_hosts out_of_reach process_info raise_limit reaper "
    "require_reached room_for_a_start run_begun shorten spawn stop_times tail text_of_latest_run unknown_instances "
    "unreached"
)
