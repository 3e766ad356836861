"""Other hosts than the manager's: reached by OpenSSH, where `midstride host` runs that host's own back end."""

PUBLIC = (
    "CONNECT_SECONDS CheckedHost HOST_PROTOCOL HostFault HostOrder HostReport HostService HostsBackend LONGEST_LINE "
    "LONGEST_PAUSE RANGE SshConnection answer_line call_forms check_all directory_of faults_on_hosts find_or_start "
    "host_frames remove_passing running socket_of"
)
