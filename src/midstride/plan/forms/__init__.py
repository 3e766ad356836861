"""The JSON forms of plans, their steps, and requests for changes."""

PUBLIC = (
    "AnyStep AttachStep ChangeRequest DetachStep HandoverStep PlanForm PlanPreview RemoveStep decode_plan "
    "decode_request plan_form request_names step_forms"
)
