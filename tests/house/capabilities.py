"""Every capability as a person meets it, each with the tests that hold it: `path::name` below `tests`.

A new command, page, document, condition, channel, fault or law enters here (`test_capabilities` asks for it).
When a test is moved or renamed, its row follows. A row goes only with the capability.
"""

COMMANDS: dict[str, tuple[str, ...]] = {  # each command of `joint-monitor --help`, and of its groups
    "ack": (
        "publish/test_alert_commands.py::test_the_command_line_takes_the_beginning_of_an_alerts_name",
        "publish/test_daemon_on_the_bus.py::test_an_alert_is_acknowledged_and_shelved_by_name_and_stays_so_through_a_restart",
    ),
    "alerts": ("cli/test_names_and_outputs.py::test_a_cleared_alert_says_when_it_cleared_and_asks_for_nothing",),
    "allow": (
        "cli/test_commands_motion.py::test_a_protective_stop_waits_for_a_person_with_name_and_reason",
        "service/test_motion.py::test_allow_names_the_arm_that_is_expected_from_now_on",
        "service/test_left_arm.py::test_a_person_lets_the_arm_be_brought_back_and_the_history_keeps_who_and_why",
    ),
    "assess": (
        "store/test_series.py::test_assess_prints_one_object",
        "store/test_series.py::test_a_series_gives_the_daemons_verdicts",
        "store/test_series.py::test_why_a_joint_does_not_alert_is_printed_on_request",
    ),
    "base": (
        "cli/test_commands_arm.py::test_base_prints_the_whole_object",
        "cli/test_commands_arm.py::test_base_without_json_is_a_table_to_read",
    ),
    "campaign": (
        "service/test_campaign.py::test_a_campaign_ends_when_no_joint_changes_any_more_and_the_history_has_each_replay",
        "service/test_campaign.py::test_a_campaign_is_bounded_and_ends_with_the_first_replay_that_is_not_learnt_from",
    ),
    "check": (
        "cli/test_commands_motion.py::test_check_looks_and_neither_uploads_nor_moves_anything",
        "cli/test_commands_motion.py::test_check_names_each_obstacle_to_a_motion_and_ends_with_three",
        "cli/test_commands_motion.py::test_check_reports_who_answers_on_the_bus",
    ),
    "demo": (
        "studies/test_demo.py::test_the_demo_finds_the_worn_joint_and_no_other_and_is_never_silent",
        "studies/test_demo.py::test_two_days_of_the_demo_are_played_judged_and_told",
    ),
    "deploy-files": ("deploy/test_package.py::test_the_files_of_deployment_are_written_whole_and_start_the_program_that_wrote_them",),
    "design": (
        "design/test_command.py::test_the_same_command_gives_the_same_bytes_and_a_picture",
        "design/test_command.py::test_ctrl_c_keeps_the_best_so_far",
    ),
    "energy": (
        "cli/test_commands_arm.py::test_energy_of_a_simulated_arm_is_its_own",
        "cli/test_commands_arm.py::test_energy_with_limits_gives_its_verdict_and_that_it_is_no_safety_function",
    ),
    "export": ("cli/test_commands_history.py::test_what_is_exported_can_be_read_by_others_and_a_recording_be_imported_again",),
    "gateway": ("gateway/test_gateway_commands.py::test_a_wrong_configuration_ends_with_78_and_so_does_one_without_a_channel",),
    "gateway check": ("gateway/test_gateway_commands.py::test_check_and_status_print_what_the_page_shows",),
    "gateway run": ("gateway/test_gateway_commands.py::test_the_service_tells_systemd_that_it_runs_delivers_and_ends_at_sigterm",),
    "gateway status": (
        "gateway/test_gateway_commands.py::test_check_and_status_print_what_the_page_shows",
        "gateway/test_gateway_commands.py::test_status_that_root_asks_leaves_the_services_files_to_the_service",
    ),
    "history": ("cli/test_commands_history.py::test_history_prints_what_was_learnt_and_how_much_it_left_out",),
    "identify": (
        "cli/test_program.py::test_a_real_recording_is_identified_as_json",
        "cli/test_commands_identify.py::test_identify_draws_its_residuals",
        "cli/test_commands_identify.py::test_a_consistent_fit_is_exported_as_an_arm_that_pinocchio_loads",
        "cli/test_commands_identify.py::test_identify_selects_a_law_and_prints_the_criterion",
    ),
    "import": (
        "cli/test_commands_history.py::test_recordings_made_elsewhere_become_history_and_are_marked",
        "cli/test_commands_history.py::test_imported_recordings_of_one_motion_share_a_name_and_a_shorter_motion_has_its_own",
    ),
    "init": (
        "cli/test_init.py::test_an_arm_tells_what_it_knows_and_the_file_is_right",
        "cli/test_init.py::test_a_person_answers_what_no_option_says",
        "cli/test_init.py::test_gains_come_from_a_payload_pair_of_recordings",
    ),
    "inspected": (
        "service/test_inspection.py::test_a_check_is_recorded_without_a_daemon_and_status_tells_it",
        "publish/test_serviced.py::test_a_check_is_recorded_from_a_computer_without_the_history",
    ),
    "listen": ("cli/test_commands_production.py::test_listen_tells_friction_of_every_joint_by_a_recording_and_by_json",),
    "models": ("cli/test_names_and_outputs.py::test_the_list_of_commands_is_not_cut_and_models_are_listed",),
    "plant": ("plant/test_on_the_bus.py::test_a_plant_copies_its_arms_follows_them_and_tells_who_is_gone",),
    "plant backup": ("plant/test_backup.py::test_a_backup_of_either_database_is_restored_into_the_other",),
    "plant check": ("plant/test_access.py::test_the_check_of_a_plant_asks_every_monitor_with_the_plants_own_certificate",),
    "plant enrol": (
        "plant/test_enrolment.py::test_every_arm_gets_a_configuration_that_loads_and_moves_nothing",
        "plant/test_enrolment.py::test_the_commands_write_say_and_check",
    ),
    "plant forget": ("plant/test_backup.py::test_the_commands_say_what_they_did",),
    "plant rebuild": ("plant/test_backup.py::test_a_rebuilt_database_is_the_same_again",),
    "plant restore": ("plant/test_backup.py::test_a_database_that_is_not_empty_is_replaced_only_by_force_and_its_audit_stays",),
    "plant run": (
        "plant/test_on_the_bus.py::test_a_real_daemon_is_copied_and_its_document_says_how_far_it_is",
        "plant/test_settings.py::test_the_command_ends_with_78_where_the_configuration_is_wrong_and_with_2_where_an_argument_is",
    ),
    "plant status": ("plant/test_ranking.py::test_the_page_shows_lines_as_they_are_printed",),
    "plant user": ("plant/test_screen.py::test_the_command_puts_users_in_and_takes_them_out",),
    "predict": (
        "golden/test_golden.py::test_the_verdicts_of_two_weeks_are_unchanged",
        "judge/test_compensation.py::test_torque_is_predicted_by_the_selected_temperature_law",
    ),
    "prior": ("studies/test_fleet_prior.py::test_the_command_learns_from_histories_and_a_new_arm_takes_what_it_writes",),
    "query": ("studies/test_query.py::test_the_command_prints_a_table_csv_or_json_and_says_when_there_is_more",),
    "reassess": (
        "studies/test_reassess.py::test_every_verdict_of_a_plant_comes_out_the_same_to_the_last_bit",
        "studies/test_reassess.py::test_other_thresholds_move_alerts_and_a_picture_shows_it",
    ),
    "record": ("cli/test_commands_motion.py::test_record_only_listens_while_another_program_moves_the_arm",),
    "rehearse": (
        "store/test_series.py::test_rehearse_answers_for_a_configuration",
        "cli/test_commands_rehearse.py::test_a_world_is_played_by_its_name",
    ),
    "replay": ("cli/test_commands_motion.py::test_the_first_pass_after_a_change_is_slow_and_kept_and_the_next_replay_needs_none",),
    "report": ("views/test_report.py::test_the_command_writes_the_page_and_the_document",),
    "reproduce": ("studies/test_reproduce.py::test_every_figure_and_table_of_the_paper_has_its_section",),
    "run": (
        "service/test_daemon.py::test_a_replay_is_assessed_published_and_still_known_after_a_restart",
        "service/test_daemon.py::test_a_wrong_configuration_ends_with_78_and_every_mistake",
    ),
    "schedule": ("cli/test_commands_history.py::test_schedule_lists_the_next_windows_in_the_sites_own_time",),
    "schema": ("docs/test_pages.py::test_every_kind_of_document_has_a_schema_that_can_be_printed",),
    "script-node": (
        "service/test_program_node.py::test_the_file_of_a_script_node_is_written_once_and_never_replaced_unasked",
        "service/test_program_node.py::test_the_file_lends_the_arm_from_an_ordinary_script_node",
    ),
    "serviced": (
        "publish/test_serviced.py::test_the_command_asks_a_running_daemon_by_the_joints_number_or_name",
        "publish/test_serviced.py::test_production_declared_while_no_daemon_runs_is_published_by_the_next_one",
        "publish/test_serviced.py::test_declared_production_can_be_taken_back_also_after_replays",
    ),
    "shelve": ("publish/test_daemon_on_the_bus.py::test_an_alert_is_acknowledged_and_shelved_by_name_and_stays_so_through_a_restart",),
    "simulate": (
        "simulate/test_sim_process.py::test_it_ends_on_sigterm_and_on_command_and_leaves_the_ports_free",
        "simulate/test_sim_process.py::test_wrong_options_give_a_message",
        "simulate/test_sim_process.py::test_the_view_shows_the_arm_and_ends_with_it",
    ),
    "simulate-plant": (
        "plant/test_simulated_plant.py::test_its_documents_are_those_of_monitors",
        "plant/test_simulated_plant.py::test_the_same_seed_lives_the_same_life",
    ),
    "simulate-production": (
        "docs/test_shown_commands.py::test_a_shown_command_prints_what_its_page_shows",
        "simulate/test_sim_cells.py::test_every_cell_fits_every_arm",
    ),
    "status": (
        "service/test_housekeeping.py::test_status_reports_a_monitor_that_no_longer_publishes",
        "judge/test_rules.py::test_status_names_the_stale_joints_of_a_stored_health",
    ),
    "try": (
        "studies/test_trial.py::test_days_pass_in_seconds_and_no_window_is_missed",
        "studies/test_trial.py::test_an_arm_that_a_program_lends_is_tried_without_one",
    ),
    "unack": ("publish/test_alert_commands.py::test_a_second_acknowledgement_is_appended_and_both_can_be_taken_back",),
    "unshelve": (
        "publish/test_alert_commands.py::test_the_command_line_takes_the_beginning_of_an_alerts_name",
        "judge/test_alert_evidence.py::test_an_acknowledgement_and_a_shelving_can_be_taken_back",
    ),
    "watch": (
        "publish/test_outside_programs.py::test_watch_is_coloured_on_a_terminal_and_plain_in_a_pipe",
        "publish/test_outside_programs.py::test_every_document_is_shown_on_one_line_and_streams_in_words",
        "publish/test_bus.py::test_a_watcher_is_told_when_the_monitor_is_gone_and_when_it_is_back",
    ),
}

USE_OF_THE_COMMANDS: dict[str, tuple[str, ...]] = {  # what holds for all commands
    "help is fast and explains every command": (
        "cli/test_program.py::test_help_names_every_command_and_imports_nothing_heavy",
        "cli/test_program.py::test_every_command_explains_itself",
    ),
    "a mistake is a sentence and an exit code": ("cli/test_program.py::test_wrong_arguments_are_sentences",),
    "several arms by name or by a variable": (
        "cli/test_names_and_outputs.py::test_a_configuration_is_named_by_its_name_by_a_variable_and_several_at_once",
    ),
    "joints by number or name": ("cli/test_first_hour.py::test_every_command_knows_a_joint_by_its_name",),
    "times in the zone of the schedule": ("cli/test_names_and_outputs.py::test_times_are_those_of_the_schedules_zone",),
    "no output is replaced unasked": ("cli/test_names_and_outputs.py::test_an_output_is_not_replaced_unasked",),
    "shell completion": ("cli/test_first_hour.py::test_the_shell_completes_models_and_scenarios",),
    "progress of long work": ("cli/test_names_and_outputs.py::test_progress_says_what_is_under_way_and_how_much_is_left",),
    "hints before the first run": ("cli/test_program.py::test_before_the_first_run_the_commands_say_what_is_missing",),
    "a command is added in one module": (
        "cli/test_add_a_command.py::test_the_new_command_is_in_the_help",
        "cli/test_add_a_command.py::test_the_new_command_runs",
    ),
}

PAGES: dict[str, tuple[str, ...]] = {  # each address of the arm's page and of the plant's screen
    "arm /": (
        "views/test_page_browser.py::test_the_state_of_the_arm_is_seen_at_once",
        "views/test_page_server.py::test_everything_the_page_needs_comes_from_here",
    ),
    "arm /static/{name}": ("views/test_page_server.py::test_the_vendored_library_is_declared_and_shipped",),
    "arm /words/{code}.js": (
        "views/test_page_browser.py::test_no_english_sentence_remains_in_the_german_page",
        "views/test_page_server.py::test_the_page_comes_in_the_language_of_the_browser",
    ),
    "arm /login": (
        "views/test_page_server.py::test_without_the_token_nothing_is_shown",
        "views/test_page_browser.py::test_a_new_monitor_asks_for_its_token_and_claims_nothing",
    ),
    "arm /api/about": ("views/test_page_server.py::test_everything_the_page_needs_comes_from_here",),
    "arm /api/history": (
        "views/test_page_server.py::test_the_history_comes_as_columns",
        "views/test_page_server.py::test_five_years_of_history_are_answered_quickly",
    ),
    "arm /api/schedule": ("views/test_page_browser.py::test_a_replay_that_waits_for_the_programs_node_is_shown_with_what_kept_it_waiting",),
    "arm /api/monitor": ("views/test_page_connection.py::test_an_arm_that_is_not_received_is_shown_at_the_top_without_live_torque",),
    "arm /report": ("views/test_page_server.py::test_report_and_history_are_made_on_request",),
    "arm /history.csv": ("views/test_page_server.py::test_report_and_history_are_made_on_request",),
    "arm /api/live": (
        "views/test_page_server.py::test_the_stream_sends_the_values_of_the_bus",
        "views/test_page_server.py::test_a_stream_sends_the_monitors_time_again_and_again",
    ),
    "arm /api/cmd/{command}": (
        "views/test_page_server.py::test_a_person_acknowledges_through_the_same_code_as_the_bus",
        "views/test_page_browser.py::test_an_alert_is_acknowledged_by_a_click_and_two_browsers_see_it",
        "views/test_page_browser.py::test_a_person_allows_motion_after_a_stop",
        "views/test_page_browser.py::test_production_on_a_joint_is_declared_on_the_page",
        "views/test_page_browser.py::test_checks_hours_and_stops_are_shown_and_a_check_is_recorded_by_a_click",
    ),
    "plant /": (
        "plant/test_screen.py::test_the_list_shows_the_worst_first_with_its_alerts",
        "views/test_plant_browser.py::test_the_sick_arm_stands_first_and_nothing_is_cut",
    ),
    "plant /login": (
        "plant/test_screen.py::test_people_who_sign_in_at_once_are_all_in",
        "plant/test_screen.py::test_a_wrong_token_opens_nothing_and_is_audited",
    ),
    "plant /static/{name}": ("views/test_plant_browser.py::test_search_filters_and_keys",),
    "plant /words/{code}.js": ("views/test_plant_browser.py::test_search_filters_and_keys",),
}

INTERFACE: dict[str, tuple[str, ...]] = {  # operations of the plant's interface, /api/v1
    "listArms": (
        "plant/test_screen.py::test_the_list_is_compressed_for_whoever_can_read_it",
        "plant/test_screen.py::test_whatever_one_arm_says_the_screen_of_all_arms_is_drawn",
    ),
    "readArm": ("plant/test_interface.py::test_an_arm_and_its_joints_are_read",),
    "listJoints": ("plant/test_interface.py::test_an_arm_and_its_joints_are_read",),
    "readHistory": ("plant/test_interface.py::test_a_history_is_paged_without_a_gap",),
    "listPeers": ("views/test_plant_browser.py::test_a_joint_without_a_history_says_so_among_its_peers",),
    "listAlerts": ("plant/test_interface.py::test_alerts_are_filtered_and_paged",),
    "readAudit": ("plant/test_screen.py::test_who_may_see_what",),
    "streamEvents": ("plant/test_interface.py::test_transitions_come_as_a_stream_and_nothing_is_lost_over_a_cut",),
    **dict.fromkeys(
        ("ack", "unack", "shelve", "unshelve", "serviced", "unserviced", "inspected", "uninspected"),
        ("plant/test_interface.py::test_each_role_does_what_it_may_at_each_site_and_each_refusal_is_audited",),
    ),
}

USE_OF_THE_PAGES: dict[str, tuple[str, ...]] = {  # what a person does and sees there
    "an arm's page from the plant's screen": (
        "plant/test_screen.py::test_an_arms_page_is_that_of_its_own_monitor",
        "plant/test_screen.py::test_a_silent_arms_page_shows_what_was_copied_of_its_joints",
    ),
    "live torque and drawing": ("views/test_page_browser.py::test_torque_and_drawing_move_with_the_arm",),
    "the friction law that predicts": ("views/test_page_browser.py::test_the_law_drawn_is_the_one_that_predicts_torque",),
    "choosing a joint everywhere": ("views/test_page_browser.py::test_choosing_a_joint_in_drawing_table_or_tabs_shows_it_everywhere",),
    "keyboard alone": ("views/test_page_browser.py::test_everything_can_be_done_by_keyboard",),
    "every size and colour scheme": (
        "views/test_page_browser.py::test_it_fits_and_can_be_read_in_every_size_and_scheme",
        "views/test_page_browser.py::test_the_theme_button_is_remembered",
        "views/test_page_colours.py::test_every_state_has_a_contrast_of_4_5_on_every_ground",
    ),
    "print on white": ("views/test_page_browser.py::test_a_dark_page_is_printed_on_white",),
    "German": (
        "views/test_page_browser.py::test_no_english_sentence_remains_in_the_german_page",
        "views/test_page_browser.py::test_the_dialogs_and_the_report_are_german_too",
        "views/test_page_browser.py::test_the_language_is_chosen_by_a_link_and_remembered",
    ),
    "lost connection is shown": (
        "views/test_page_connection.py::test_a_silent_monitor_is_noticed_and_found_again",
        "views/test_page_connection.py::test_a_page_whose_session_has_ended_asks_for_the_token_again",
    ),
    "old verdicts are marked": ("views/test_page_browser.py::test_an_old_verdict_is_marked_with_advice",),
    "a refusal is shown": ("views/test_page_browser.py::test_a_refusal_is_shown_in_the_dialog",),
    "production and maintenance of a joint": (
        "views/test_page_browser.py::test_a_joint_says_what_came_from_production_and_how_far_the_next_replay_is",
        "views/test_maintenance_shown.py::test_production_is_a_mark_on_the_chart_of_its_joint_and_says_whether_friction_counts_anew",
    ),
    "roles and people of the plant": (
        "plant/test_screen.py::test_who_may_see_what",
        "plant/test_screen.py::test_a_user_who_is_taken_out_of_the_file_is_out_at_once",
        "plant/test_screen.py::test_a_trusted_proxy_says_who_somebody_is_and_nobody_else_does",
    ),
    "foreign pages command nothing": (
        "views/test_page_server.py::test_a_page_of_another_site_cannot_command",
        "plant/test_screen.py::test_a_command_of_a_foreign_page_is_refused",
        "plant/test_attacks.py::test_a_foreign_page_opens_no_stream",
    ),
    "acknowledging at the plant": ("views/test_plant_browser.py::test_an_alert_is_acknowledged_with_name_and_reason",),
}

REPORT: dict[str, tuple[str, ...]] = {  # the printed page
    "one state and one sentence on every page, report, message and protocol": (
        "views/test_shown_alike.py::test_every_alert_has_one_pill_one_state_and_one_sentence",
        "views/test_shown_alike.py::test_what_is_of_then_is_normal_nowhere",
    ),
    "the deciding sentence leads": ("views/test_report.py::test_the_report_leads_with_the_sentence_that_decides",),
    "everything with its evidence": ("views/test_report.py::test_everything_that_happened_is_reported_with_its_evidence",),
    "a period": (
        "views/test_report.py::test_a_period_holds_only_what_is_in_it",
        "views/test_report.py::test_an_alert_is_reported_as_it_was_at_the_end_of_the_period",
    ),
    "what was not monitored and why": ("views/test_report.py::test_what_was_not_monitored_is_reported_with_the_reason",),
    "friction over temperature": ("views/test_report.py::test_friction_over_temperature_is_drawn_as_the_law_that_was_chosen",),
    "maintenance and who took it back": (
        "views/test_maintenance_shown.py::test_the_report_has_a_table_of_production_with_what_it_meant_and_who_took_it_back",
    ),
    "stops and who allowed motion": ("views/test_report.py::test_a_stop_is_in_the_file_with_who_allowed_motion_again",),
    "one sheet for a quiet month": ("views/test_report.py::test_a_month_in_which_nothing_happened_is_one_sheet_of_paper",),
    "German": ("views/test_report.py::test_the_report_is_written_in_the_language_that_is_asked_for",),
    "no network": ("views/test_report.py::test_the_page_needs_no_network_and_holds_what_the_document_holds",),
}

DOCUMENTS: dict[str, tuple[str, ...]] = {  # each kind on the bus (`publish.registry`)
    "info": (
        "publish/test_daemon_on_the_bus.py::test_info_gives_the_settings_in_force_and_since_when",
        "publish/test_daemon_on_the_bus.py::test_after_a_reload_info_has_the_digest_of_the_settings_in_force",
    ),
    "health": (
        "publish/test_daemon_on_the_bus.py::test_a_client_reads_the_health_of_an_arm_with_an_alert",
        "publish/test_daemon_on_the_bus.py::test_a_week_without_replays_makes_the_state_stale_until_the_next_one",
    ),
    "friction": (
        "test_assess.py::test_the_published_law_is_the_one_from_which_torque_is_predicted",
        "publish/test_daemon_on_the_bus.py::test_everything_published_and_answered_is_valid_by_its_schema",
    ),
    "alert": ("test_assess.py::test_an_alert_document_states_whether_it_is_active",),
    "event": ("publish/test_daemon_on_the_bus.py::test_a_watcher_of_event_alone_gets_transitions_and_nothing_else",),
    "events": ("publish/test_daemon_on_the_bus.py::test_a_watcher_that_was_disconnected_gets_what_it_missed_once_and_in_order",),
    "model": ("judge/test_compensation.py::test_a_reader_of_the_document_alone_finds_the_same_friction",),
    "torque-request": (
        "publish/test_answers.py::test_a_wrong_request_is_named",
        "publish/test_answers.py::test_any_json_is_answered_or_refused",
    ),
    "torque": (
        "publish/test_answers.py::test_the_answer_is_the_torque_of_the_law_behind_the_data",
        "publish/test_answers.py::test_far_from_the_learnt_temperature_the_answer_is_flagged",
    ),
    "torque-live": (
        "publish/test_daemon_on_the_bus.py::test_live_torque_has_the_measured_and_the_predicted_torque",
        "publish/test_daemon_on_the_bus.py::test_live_torque_comes_at_the_configured_rate",
    ),
    "history": ("publish/test_daemon_on_the_bus.py::test_history_comes_in_pages_of_whole_replays",),
    "monitor": ("service/test_housekeeping.py::test_the_monitor_document_is_valid_by_its_schema_and_printed_by_status",),
    "ack-request": ("publish/test_daemon_on_the_bus.py::test_an_alert_is_acknowledged_and_shelved_by_name_and_stays_so_through_a_restart",),
    "unack-request": ("publish/test_alert_commands.py::test_a_second_acknowledgement_is_appended_and_both_can_be_taken_back",),
    "shelve-request": (
        "publish/test_daemon_on_the_bus.py::test_an_alert_is_acknowledged_and_shelved_by_name_and_stays_so_through_a_restart",
    ),
    "unshelve-request": ("judge/test_alert_evidence.py::test_an_acknowledgement_and_a_shelving_can_be_taken_back",),
    "serviced-request": (
        "publish/test_serviced.py::test_a_replaced_joint_is_declared_on_the_bus_and_everybody_hears_of_it",
        "publish/test_serviced.py::test_production_that_does_not_fit_the_arm_is_refused_with_the_reason",
    ),
    "unserviced-request": ("publish/test_serviced.py::test_declared_production_can_be_taken_back_also_after_replays",),
    "maintenance": (
        "publish/test_serviced.py::test_a_replaced_joint_is_declared_on_the_bus_and_everybody_hears_of_it",
        "publish/test_serviced.py::test_a_greased_joint_waits_for_its_proof",
    ),
    "compensation": (
        "publish/test_compensation_document.py::test_the_terms_are_the_friction_of_the_predicted_torque_with_its_doubt",
        "publish/test_compensation_document.py::test_every_replay_counts_at_one_temperature_and_those_without_any_are_extrapolated",
        "service/test_daemon.py::test_a_replay_is_assessed_published_and_still_known_after_a_restart",
    ),
    "from-production": (
        "service/test_production_listener.py::test_a_day_of_production_is_judged_after_midnight_and_enters_the_history_with_the_state",
        "publish/test_daemon_on_the_bus.py::test_the_production_residual_is_published_with_health",
    ),
    "inspection": ("service/test_inspection.py::test_the_document_fits_its_schema_and_stands_in_status_report_and_metrics",),
    "inspected-request": ("publish/test_serviced.py::test_a_check_is_recorded_on_the_bus_and_everybody_hears_of_it",),
    "uninspected-request": ("publish/test_serviced.py::test_a_check_is_recorded_on_the_bus_and_everybody_hears_of_it",),
    "replay-request": ("publish/test_daemon_on_the_bus.py::test_a_replay_is_requested_by_name_and_refused_with_a_reason",),
    "replay": ("publish/test_daemon_on_the_bus.py::test_everything_published_and_answered_is_valid_by_its_schema",),
    "permit": (
        "cli/test_commands_motion.py::test_the_cells_own_program_permits_over_zenoh",
        "acquire/test_driver.py::test_a_permit_is_asked_again_while_the_arm_moves",
    ),
    "permit-answer": (
        "publish/test_permit_words.py::test_a_malformed_answer_is_no_permit_and_no_exception",
        "publish/test_permit_words.py::test_a_missing_answer_is_no_permit",
    ),
    "answer": ("publish/test_daemon_on_the_bus.py::test_a_command_with_a_wrong_payload_does_nothing_and_names_every_mistake",),
    "error": (
        "publish/test_bus.py::test_a_malformed_query_gets_an_error_that_names_the_mistake",
        "publish/test_malformed.py::test_a_few_hundred_malformed_queries_each_get_an_error",
    ),
}

BUS: dict[str, tuple[str, ...]] = {  # what holds for all documents
    "last values for who comes late": ("publish/test_bus.py::test_a_client_that_connects_late_gets_the_last_values",),
    "any plain Zenoh client": (
        "publish/test_bus.py::test_any_plain_zenoh_client_can_subscribe_and_query",
        "publish/test_outside_programs.py::test_the_plain_zenoh_example_runs_unchanged",
        "publish/test_outside_programs.py::test_the_jq_example_runs_unchanged",
        "publish/test_outside_programs.py::test_the_node_example_runs_unchanged",
    ),
    "a wildcard never acts": (
        "publish/test_daemon_on_the_bus.py::test_a_wildcard_never_acknowledges_anything_nor_moves_an_arm",
        "publish/test_daemon_on_the_bus.py::test_a_wildcard_anywhere_in_the_key_never_acts",
    ),
    "transitions once over restarts": ("publish/test_restarts.py::test_restarts_lose_and_repeat_no_transition",),
    "slow clients and floods": (
        "publish/test_slow_clients.py::test_a_client_that_no_longer_reads_is_disconnected_and_may_return",
        "publish/test_slow_clients.py::test_every_query_of_a_flood_is_answered_or_refused",
        "publish/test_slow_clients.py::test_a_payload_that_is_too_large_is_refused_unread",
    ),
    "roles by certificate or password": (
        "publish/test_security.py::test_maintenance_may_read_and_command",
        "publish/test_security.py::test_a_viewer_may_read_and_not_command",
        "publish/test_security.py::test_users_and_passwords_from_credentials",
        "publish/test_security.py::test_refused_clients_are_logged",
    ),
    "failures of connection are worded": (
        "publish/test_reach.py::test_every_failure_of_tls_has_its_message",
        "publish/test_reach.py::test_a_missing_and_a_wrong_password_have_their_messages",
        "publish/test_reach.py::test_each_failure_through_a_router_has_its_message",
    ),
    "a new kind is one entry": ("publish/test_new_document.py::test_a_new_kind_of_document_is_one_entry_in_the_registry",),
    "released schemas keep their promises": (
        "publish/test_recorded_v1.py::test_todays_schemas_keep_the_promises_of_earlier_ones",
        "publish/test_recorded_v1.py::test_a_recorded_document_is_read_by_todays_types_and_valid_by_todays_schema",
    ),
    "metrics for Prometheus": (
        "publish/test_metrics.py::test_a_scrape_has_the_figures_of_the_bus",
        "publish/test_metrics.py::test_a_real_prometheus_scrapes_it_and_its_rules_fire",
        "publish/test_metrics.py::test_every_rule_fires_when_it_should_and_not_before",
    ),
    "dashboards for Grafana": (
        "publish/test_metrics.py::test_a_dashboard_is_as_grafana_documents_it",
        "publish/test_metrics.py::test_every_query_of_a_dashboard_is_answered_by_a_real_prometheus",
    ),
}

ALERTS: dict[str, tuple[str, ...]] = {  # each condition (`judge.alerts`)
    "wear_rising": (
        "judge/test_rules.py::test_a_rise_that_was_found_is_told_at_once_by_its_size",
        "test_assess.py::test_wear_of_ten_percent_a_month_is_detected_in_its_joint",
    ),
    "sudden_step": (
        "test_assess.py::test_a_step_of_eight_percent_is_detected",
        "judge/test_learn.py::test_a_jump_that_stays_is_a_step_within_days",
    ),
    "friction_falling": ("judge/test_rules.py::test_falling_friction_is_reported_and_is_no_wear",),
    "common_mode": (
        "judge/test_rules.py::test_all_joints_rising_together_is_not_wear",
        "judge/test_reference.py::test_a_common_step_is_told_once_of_the_arm_and_blames_no_joint",
    ),
    "gain_contradiction": ("judge/test_undeclared_change.py::test_a_gain_that_changed_is_named_and_is_no_wear",),
    "mounting_contradiction": ("judge/test_undeclared_change.py::test_a_mounting_that_contradicts_gravity_is_no_wear",),
    "payload_contradiction": (
        "judge/test_undeclared_change.py::test_an_undeclared_payload_is_named_and_is_no_wear",
        "judge/test_undeclared_change.py::test_a_few_hundred_grams_are_told_as_a_payload",
    ),
    "temperature_sensor": (
        "judge/test_temperature.py::test_a_stuck_sensor_is_reported_and_a_winter_is_no_wear",
        "judge/test_temperature.py::test_an_impossible_temperature_is_not_learnt_from_and_is_reported",
        "judge/test_temperature.py::test_any_sensors_that_stand_still_are_told_whatever_the_others_do",
    ),
    "current_noise": (
        "judge/test_beside.py::test_a_noisier_current_is_told_as_noise_and_not_as_wear",
        "identify/test_ripple.py::test_the_noise_of_a_joints_current_is_measured_whatever_the_motion_and_spikes",
    ),
    "gear_ripple": (
        "judge/test_beside.py::test_ripple_that_grows_is_told_of_its_joint_and_no_wear",
        "judge/test_beside.py::test_ripple_of_sound_gears_that_is_often_zero_is_quiet",
        "evidence/test_faults.py::test_an_encoder_off_its_centre_is_told_by_ripple_and_by_nothing_else",
    ),
    "data_quality": (
        "judge/test_learn.py::test_a_single_outlier_teaches_little_and_is_reported",
        "judge/test_alert_evidence.py::test_a_replay_without_data_of_the_joint_does_not_clear_its_acknowledged_alert",
    ),
    "outside_range": (
        "judge/test_rules.py::test_a_joint_outside_the_learnt_temperatures_is_off_spec",
        "judge/test_conditions.py::test_a_new_temperature_that_stays_is_learnt_and_raises_nothing",
    ),
    "store_restored": ("publish/test_restored_history.py::test_a_restored_history_is_an_alert_until_it_is_acknowledged",),
    "stopped": ("service/test_own_alerts.py::test_a_stop_is_an_alert_at_once_and_allowing_motion_clears_it_with_name_and_reason",),
    "stale": (
        "service/test_own_alerts.py::test_thirty_five_days_without_a_verdict_are_no_green_normal",
        "judge/test_rules.py::test_joints_without_a_replay_for_a_week_are_stale",
    ),
    "unheard": ("service/test_own_alerts.py::test_an_arm_that_is_not_heard_is_an_alert_after_two_windows_and_it_survives_restarts",),
}

VERDICTS: dict[str, tuple[str, ...]] = {  # how they are found, kept and explained
    "tiers, acknowledging, clearing": (
        "judge/test_rules.py::test_a_higher_tier_must_be_acknowledged_again",
        "judge/test_rules.py::test_an_alert_clears_once_it_is_acknowledged_and_its_condition_is_gone",
        "judge/test_rules.py::test_an_acknowledged_alert_does_not_flap",
    ),
    "evidence stays": (
        "judge/test_alert_evidence.py::test_the_gravest_moment_stays_with_its_figures_date_and_sentence",
        "judge/test_alert_evidence.py::test_the_first_acknowledgement_stays_and_later_ones_are_appended",
    ),
    "reasons why not": ("judge/test_rules.py::test_the_reasons_why_a_joint_does_not_alert_are_given_in_the_models_terms",),
    "causes of a change": ("judge/test_rules.py::test_a_change_is_attributed_to_its_causes",),
    "temperature is no wear": (
        "test_assess.py::test_a_cold_monday_is_no_wear",
        "judge/test_learn.py::test_a_fast_warm_up_is_no_wear",
    ),
    "quiet year": ("test_assess.py::test_a_quiet_year_raises_no_wear_alert",),
    "side channels": (
        "judge/test_beside.py::test_wear_that_leaves_friction_at_the_reference_speed_is_found_within_30_days",
        "judge/test_beside.py::test_the_alert_of_an_arm_says_which_series_found_it",
    ),
    "remaining life": (
        "test_assess.py::test_remaining_life_is_near_the_truth_for_a_constant_rate",
        "evidence/test_judge_wear.py::test_p10_to_p90_hold_eight_of_ten_on_every_path",
        "judge/test_usage.py::test_remaining_life_is_given_in_revolutions",
    ),
    "maintenance of a joint": (
        "judge/test_maintenance.py::test_a_serviced_joint_waits_for_its_proof_and_is_normal_once_replays_have_shown_it",
        "judge/test_maintenance.py::test_a_new_serial_number_clears_the_alerts_of_that_joint_alone",
    ),
    "declared and undeclared payloads": (
        "judge/test_learn.py::test_a_new_payload_keeps_the_wear_and_is_reported",
        "judge/test_undeclared_change.py::test_a_payload_that_is_taken_off_again_leaves_the_old_level",
        "judge/test_undeclared_change.py::test_two_payloads_in_turn_have_a_level_each",
    ),
    "production as an observer": (
        "judge/test_production_observations.py::test_production_alone_raises_an_advisory_and_asks_for_a_replay_before_it_raises_wear",
        "judge/test_production_observations.py::test_what_differs_between_production_and_excitation_for_good_is_no_wear",
    ),
    "production residual": ("judge/test_production_residual.py::test_a_joint_whose_friction_rose_asks_for_an_earlier_replay",),
    "revolutions": (
        "judge/test_production_residual.py::test_revolutions_are_counted_while_the_arm_is_observed",
        "judge/test_usage.py::test_a_holiday_causes_no_wear_where_revolutions_are_counted",
    ),
    "torque with intervals": (
        "judge/test_compensation.py::test_torque_is_predicted_by_the_selected_temperature_law",
        "identify/test_real_recordings.py::test_the_measured_torque_of_a_real_arm_stays_in_its_interval",
    ),
    "gear ripple": ("judge/test_ripple_track.py::test_ripple_is_published_stored_and_continued",),
    "a fleet's prior": (
        "studies/test_fleet_prior.py::test_intervals_with_a_prior_cover_as_they_say_in_the_first_weeks",
        "judge/test_fleet_wear.py::test_a_fleet_that_wears_along_one_path_says_so_and_how_long_it_takes",
    ),
    "a condition is one record": (
        "judge/test_new_condition.py::test_the_steps_of_the_page_make_a_condition_that_is_told_in_every_language",
        "judge/test_conditions.py::test_a_registered_condition_is_raised_acknowledged_and_cleared",
    ),
    "recomputed to the last bit": (
        "service/test_backups_and_retention.py::test_every_past_verdict_is_recomputed_to_the_last_bit",
        "judge/test_belief.py::test_a_belief_read_from_json_gives_the_same_next_assessment",
    ),
    "worlds of a rehearsal": (
        "cli/test_commands_rehearse.py::test_a_world_is_played_by_its_name",
        "studies/test_worlds.py::test_a_plain_world_is_judged_and_its_document_is_plain_json",
        "evidence/test_card.py::test_every_world_of_the_card_has_arms",
    ),
    "the performance card": (
        "evidence/test_card.py::test_the_card_has_a_row_a_world_with_its_goals",
        "evidence/test_card.py::test_the_card_marks_what_was_not_reached",
    ),
}

MOTION_CONDITIONS: dict[str, tuple[str, ...]] = {  # each condition before a motion (`acquire.safety`)
    "motion_allowed": (
        "acquire/test_guard.py::test_motion_is_off_by_default",
        "acquire/test_guard.py::test_only_true_itself_allows_motion",
        "config/test_config.py::test_only_the_boolean_true_lets_an_arm_move",
    ),
    "address": ("acquire/test_guard.py::test_motion_is_allowed_only_at_a_literal_address_of_the_local_network",),
    "time_window": (
        "acquire/test_guard.py::test_a_motion_must_end_before_its_window_does",
        "acquire/test_guard.py::test_a_window_is_open_in_utc_and_may_pass_midnight",
    ),
    "trajectory": (
        "acquire/test_guard.py::test_an_excitation_of_another_robot_is_refused_by_name",
        "acquire/test_guard.py::test_a_curve_beyond_a_limit_is_refused_with_joint_value_and_limit",
    ),
    "trajectory_clear": (
        "acquire/test_guard_cell.py::test_a_trajectory_that_was_changed_by_hand_is_detected",
        "acquire/test_guard_cell.py::test_a_trajectory_without_a_proof_is_refused_where_a_cell_is_known",
    ),
    "drive_gains": ("acquire/test_installation.py::test_an_arm_whose_gains_nobody_knows_is_refused_by_the_name_of_the_key",),
    "tcp_speed": ("acquire/test_installation.py::test_a_trajectory_faster_than_the_installations_limit_is_refused",),
    "safety_planes": ("acquire/test_installation.py::test_a_trajectory_or_a_way_to_its_start_beyond_a_safety_plane_is_refused",),
    "previous_stop": (
        "store/test_store.py::test_a_stop_waits_until_a_person_allows_motion_again",
        "acquire/test_guard.py::test_each_condition_can_fail_and_is_the_one_that_is_named",
    ),
    "services": ("acquire/test_services.py::test_a_closed_port_is_named_with_the_menu_that_opens_it",),
    "robot_model": ("acquire/test_guard.py::test_each_condition_can_fail_and_is_the_one_that_is_named",),
    "software": (
        "acquire/test_installation.py::test_software_that_nobody_tested_is_refused_and_what_crashes_always_is",
        "acquire/test_installation.py::test_the_release_of_the_client_library_is_named_beside_the_tested_one",
        "acquire/test_versions.py::test_a_replay_is_played_on_each_version_and_only_the_tested_ones_move_without_the_switch",
        "acquire/test_versions.py::test_a_replay_is_played_with_the_newest_release_of_ur_rtde_that_is_allowed",
    ),
    "serial": (
        "service/test_motion.py::test_another_arm_at_the_address_waits_for_a_person_and_begins_slowly",
        "acquire/test_guard.py::test_each_condition_can_fail_and_is_the_one_that_is_named",
    ),
    "joint_limits": ("acquire/test_joint_limits.py::test_a_trajectory_beyond_the_installations_joint_limits_is_refused",),
    "remote_control": (
        "acquire/test_guard.py::test_each_condition_can_fail_and_is_the_one_that_is_named",
        "simulate/test_sim_wire.py::test_local_control_is_refused_by_the_client",
    ),
    "safety_mode": ("acquire/test_guard.py::test_an_arm_that_is_not_ready_is_not_moved_and_the_reason_given",),
    "robot_mode": ("acquire/test_guard.py::test_an_arm_that_is_not_ready_is_not_moved_and_the_reason_given",),
    "joints_running": ("acquire/test_guard.py::test_an_arm_that_is_not_ready_is_not_moved_and_the_reason_given",),
    "teach_button": ("acquire/test_arms_as_recorded.py::test_the_freedrive_button_ends_a_motion_and_forbids_the_next",),
    "no_other_program": ("acquire/test_replay.py::test_a_program_that_already_runs_is_refused_and_left_running",),
    "finite": (
        "acquire/test_guard.py::test_an_arm_that_is_not_ready_is_not_moved_and_the_reason_given",
        "acquire/test_refusals.py::test_a_reported_value_that_is_no_number_does_not_count_as_not_reported",
    ),
    "stationary": ("acquire/test_guard.py::test_an_arm_that_is_not_ready_is_not_moved_and_the_reason_given",),
    "speed_scaling": ("acquire/test_guard.py::test_an_arm_that_is_not_ready_is_not_moved_and_the_reason_given",),
    "payload": ("acquire/test_guard.py::test_an_arm_that_is_not_ready_is_not_moved_and_the_reason_given",),
    "payload_cog": (
        "acquire/test_installation.py::test_the_tool_and_the_payloads_centre_of_the_controller_are_compared_with_the_configured_ones",
    ),
    "tcp_offset": (
        "acquire/test_installation.py::test_the_tool_and_the_payloads_centre_of_the_controller_are_compared_with_the_configured_ones",
    ),
    "gravity": ("acquire/test_guard.py::test_a_mounting_other_than_the_configured_one_is_refused",),
    "approach_near": (
        "acquire/test_guard.py::test_an_arm_that_is_not_ready_is_not_moved_and_the_reason_given",
        "service/test_left_arm.py::test_windows_that_are_refused_because_the_arm_stands_elsewhere_are_a_problem_from_the_first_on",
    ),
    "approach_clear": ("acquire/test_guard_cell.py::test_an_approach_through_the_table_is_refused_and_one_from_home_is_not",),
    "temperatures": ("acquire/test_guard.py::test_an_arm_that_is_not_ready_is_not_moved_and_the_reason_given",),
    "permit": (
        "cli/test_commands_motion.py::test_a_digital_input_is_a_permit",
        "cli/test_commands_motion.py::test_the_cells_own_program_permits_over_zenoh",
    ),
}

MOTION: dict[str, tuple[str, ...]] = {  # what moves the arm, and what a person decides about it
    "a replay brings the arm back": (
        "acquire/test_replay.py::test_a_replay_of_the_real_excitation_yields_every_tick_and_brings_the_arm_back",
    ),
    "every condition is named": (
        "acquire/test_guard.py::test_every_condition_is_named_and_holds_for_an_arm_in_order",
        "acquire/test_real_idle_states.py::test_every_recorded_idle_state_passes_every_condition",
    ),
    "slow first pass": (
        "acquire/test_torque_band.py::test_every_change_asks_for_a_new_first_pass",
        "acquire/test_torque_band.py::test_a_first_pass_is_the_same_way_slower_and_once",
    ),
    "on request the arm slows down": ("acquire/test_replay.py::test_on_request_the_arm_slows_down_stands_and_its_program_ends",),
    "SIGTERM stops the arm first": (
        "service/test_daemon.py::test_sigterm_during_a_replay_stops_the_arm_first",
        "cli/test_commands_motion.py::test_a_signal_in_the_middle_of_a_replay_stops_the_arm_along_its_way",
    ),
    "windows of a schedule": (
        "acquire/test_schedule.py::test_a_watched_schedule_replays_every_window_of_a_simulated_year",
        "acquire/test_schedule.py::test_no_window_opens_on_a_blackout_day_of_the_sites_own_calendar",
        "acquire/test_schedule.py::test_a_cold_start_opens_a_window_once_a_day_and_only_after_a_rest_that_was_seen",
    ),
    "only where a replay is needed": ("service/test_scheduler.py::test_a_window_in_which_no_replay_is_needed_is_left_out_and_says_why",),
    "a requested replay": ("service/test_scheduler.py::test_a_requested_replay_runs_at_once_and_beside_the_schedule",),
    "tried again in its window": (
        "service/test_tries.py::test_a_late_target_is_tried_again_in_the_same_window_and_each_try_is_in_the_ledger",
        "service/test_tries.py::test_what_a_person_must_see_or_has_done_is_never_tried_again",
    ),
    "lent by the cell's program": (
        "acquire/test_borrowed_arm.py::test_a_replay_is_played_at_the_programs_node_and_the_program_goes_on",
        "service/test_borrowing_daemon.py::test_the_arm_is_borrowed_at_the_node_once_the_program_plays_and_the_program_goes_on",
        "acquire/test_hand_over_script.py::test_a_node_that_nobody_takes_goes_on_within_a_tenth_of_a_second",
    ),
    "the node's text": (
        "service/test_program_node.py::test_the_text_is_made_for_the_controller_and_numbered",
        "service/test_program_node.py::test_check_compares_the_text_of_today_with_that_of_the_program",
    ),
    "brought back after a harmless end": (
        "acquire/test_way_back.py::test_an_arm_that_was_stopped_on_its_trajectory_is_brought_back_and_rests_where_it_began",
        "service/test_left_arm.py::test_after_each_harmless_cause_an_arm_far_from_its_start_is_brought_back_or_a_person_is_asked_at_once",
    ),
    "nobody else's program is stopped": (
        "acquire/test_taking_control.py::test_nothing_is_sent_while_somebody_elses_program_is_there",
        "acquire/test_stop_ours.py::test_a_program_that_is_not_known_to_be_ours_is_never_stopped",
        "acquire/test_stop_ours.py::test_the_cells_program_lives_in_a_hundred_handovers",
    ),
    "watchdog is tested": (
        "acquire/test_taking_control.py::test_the_watchdog_must_end_a_program_without_targets_in_time",
        "acquire/test_idle_faults.py::test_a_watchdog_that_only_says_yes_is_found_out_at_standstill",
    ),
    "PolyScope X": (
        "acquire/test_polyscope_x.py::test_a_replay_on_a_polyscope_x_is_played_while_its_robot_api_is_asked",
        "acquire/test_robot_api.py::test_our_program_is_stopped_over_the_robot_api_and_nobody_elses",
    ),
    "CB3 and e-Series": (
        "acquire/test_replay.py::test_an_e_series_arm_is_recorded_at_125_hz_too",
        "acquire/test_many_replays.py::test_500_hz_productions_and_is_reported",
    ),
    "one motion at a time": (
        "acquire/test_replay.py::test_an_arm_that_another_client_controls_is_left_unchanged",
        "store/test_store.py::test_a_second_daemon_on_the_same_directory_is_refused",
    ),
    "only listening": (
        "acquire/test_replay.py::test_a_listener_receives_states_during_a_replay_and_survives_a_restart_of_the_controller",
        "cli/test_commands_motion.py::test_record_only_listens_while_another_program_moves_the_arm",
    ),
    "turns of an endless wrist": ("acquire/test_arms_as_recorded.py::test_a_ur3e_with_its_wrist_two_turns_on_plays_around_it",),
}

ENDS_OF_A_MOTION: dict[str, tuple[str, ...]] = {  # each cause by which a replay ends early
    "protective_stop": (
        "acquire/test_refusals.py::test_a_protective_stop_that_the_child_did_not_see_is_the_cause_all_the_same",
        "cli/test_commands_motion.py::test_a_protective_stop_waits_for_a_person_with_name_and_reason",
    ),
    "emergency_stop": ("acquire/test_failures.py::test_each_state_that_ends_the_stream_has_its_cause",),
    "safeguard_stop": ("acquire/test_failures.py::test_each_state_that_ends_the_stream_has_its_cause",),
    "safety": ("acquire/test_failures.py::test_each_state_that_ends_the_stream_has_its_cause",),
    "robot_mode": ("acquire/test_failures.py::test_each_state_that_ends_the_stream_has_its_cause",),
    "teach_button": ("acquire/test_ending_a_motion.py::test_a_freedrive_button_that_is_pressed_ends_the_motion",),
    "following_error": ("acquire/test_tracking.py::test_a_joint_that_sticks_is_seen_within_a_quarter_of_a_second",),
    "torque_band": (
        "acquire/test_torque_band.py::test_a_collision_in_an_ordinary_replay_is_found_within_a_tenth_of_a_second",
        "acquire/test_live_collision.py::test_a_collision_in_an_ordinary_replay_ends_it_within_a_quarter_of_a_second",
        "cli/test_commands_motion.py::test_torque_outside_the_band_ends_a_first_pass_and_waits_for_a_person",
    ),
    "payload": ("acquire/test_refusals.py::test_a_payload_that_is_changed_during_a_replay_ends_it",),
    "restless": (
        "service/test_left_arm.py::test_after_a_cause_that_needs_a_person_nothing_is_brought_back_although_the_person_allows_motion",
    ),
    "bad_data": ("acquire/test_tracking.py::test_a_position_that_is_no_number_is_a_failure",),
    "bad_target": ("acquire/test_ending_a_motion.py::test_an_arm_that_was_moved_since_its_way_was_proved_gets_no_target",),
    "internal": (
        "acquire/test_replay.py::test_a_callback_that_fails_does_not_leave_the_arm_moving",
        "service/test_motion.py::test_an_error_of_this_program_in_mid_motion_waits_for_a_person",
    ),
    "program_replaced": ("acquire/test_taking_control.py::test_a_program_that_ours_replaced_is_noticed_and_nothing_is_stopped",),
    "connection_lost": ("acquire/test_cuts.py::test_a_sample_of_cuts_of_single_connections_stops_the_arm_for_good",),
    "stalled": ("acquire/test_watching.py::test_a_child_that_is_silent_for_60_ms_while_the_arm_moves_is_ended",),
    "controller_restarted": ("acquire/test_ending_a_motion.py::test_a_jump_of_the_controllers_clock_ends_the_motion",),
    "child_died": ("acquire/test_kills.py::test_three_kills_at_random_moments_leave_a_standing_arm",),
    "timeout": ("acquire/test_watching.py::test_each_way_to_die_has_its_cause",),
    "late": ("acquire/test_failures.py::test_a_failure_that_late_targets_can_cause_is_named_late_and_no_other_is",),
    "program_stopped": (
        "acquire/test_ending_a_motion.py::test_a_program_that_takes_the_place_of_ours_in_mid_motion_is_named_before_the_next_target",
    ),
    "servo_refused": (
        "acquire/test_ending_a_motion.py::test_a_command_that_is_refused_over_sound_connections_has_its_cause_from_the_rows",
    ),
    "no_control": ("acquire/test_taking_control.py::test_a_program_that_does_not_start_is_given_up",),
    "no_watchdog": (
        "acquire/test_taking_control.py::test_the_watchdog_must_end_a_program_without_targets_in_time",
        "acquire/test_taking_control.py::test_a_watchdog_that_is_refused_is_named",
    ),
    "speed_scaling": ("acquire/test_refusals.py::test_a_slider_that_is_moved_during_a_replay_ends_it_whichever_variable_reports_it",),
    "joint_temperature": (
        "acquire/test_failures.py::test_each_state_that_ends_the_stream_has_its_cause",
        "acquire/test_failures.py::test_a_stop_for_temperature_names_the_joint_that_is_farthest_off_or_tells_none",
    ),
    "parent_asked_to_stop": ("acquire/test_replay.py::test_on_request_the_arm_slows_down_stands_and_its_program_ends",),
    "permit_withdrawn": ("acquire/test_driver.py::test_a_permit_is_asked_again_while_the_arm_moves",),
    "motion_forbidden": (
        "acquire/test_driver.py::test_motion_that_is_forbidden_while_the_arm_moves_stops_it",
        "service/test_daemon.py::test_a_reload_that_forbids_motion_stops_a_moving_arm",
    ),
    "local_control": ("acquire/test_driver.py::test_local_control_taken_while_the_arm_moves_stops_it_within_a_second",),
    "unknown_end": ("store/test_motions.py::test_a_motion_whose_process_was_killed_becomes_a_stop_that_waits",),
    "another_arm": ("service/test_motion.py::test_another_arm_at_the_address_waits_for_a_person_and_begins_slowly",),
    "history_restored": ("store/test_motions.py::test_a_restored_history_waits_for_a_person",),
}

CHANNELS: dict[str, tuple[str, ...]] = {  # each of the gateway (`gateway.channels`)
    "notify": (
        "gateway/test_notify_mail.py::test_a_wear_alert_is_one_mail_that_says_what_where_and_what_to_do",
        "gateway/test_notify_webhook.py::test_a_receiver_that_knows_the_documentation_alone_verifies_and_takes_each_message_once",
        "gateway/test_notify_webhook.py::test_apprise_takes_a_message_and_its_refusal_is_told_without_the_address_s_secret",
    ),
    "tickets": (
        "gateway/test_tickets.py::test_an_alert_opens_one_ticket_which_follows_it_to_its_end",
        "gateway/test_tickets.py::test_an_acknowledgement_comes_back_by_a_signed_webhook_goes_to_the_arm_once_and_is_audited",
    ),
    "mqtt": (
        "gateway/test_mqtt_broker.py::test_the_broker_keeps_each_arm_as_it_is",
        "gateway/test_mqtt_messages.py::test_discovery_follows_home_assistants_conventions",
        "gateway/test_mqtt_broker.py::test_a_button_acknowledges_the_alerts_of_its_joint",
    ),
    "opcua": (
        "gateway/test_opcua_server.py::test_a_joint_says_its_condition_with_unit_status_and_time",
        "gateway/test_opcua_server.py::test_nobody_gets_in_without_token_and_encryption",
    ),
    "ros2": (
        "gateway/test_ros2.py::test_an_arm_is_a_status_and_one_for_each_joint",
        "gateway/test_ros2.py::test_a_node_with_rmw_zenoh_hears_every_arm_and_sees_who_speaks",
    ),
}

GATEWAY: dict[str, tuple[str, ...]] = {  # what holds for its channels
    "each message once over restarts": (
        "gateway/test_frame.py::test_a_transition_is_offered_once_over_restarts_and_what_was_before_the_gateway_is_told_to_nobody",
        "gateway/test_told_once.py::test_what_was_active_before_the_gateway_first_ran_is_one_mail_and_a_ticket_each",
    ),
    "a server that is away holds up nobody": (
        "gateway/test_frame.py::test_a_channel_whose_server_is_away_holds_up_no_other_one_and_its_trouble_holds_no_secret",
        "gateway/test_notify_mail.py::test_a_day_s_outage_of_the_mail_server_loses_and_doubles_nothing",
    ),
    "slow servers": (
        "gateway/test_slow_servers.py::test_a_mail_server_that_never_ends_its_greeting_is_the_channel_s_trouble",
        "gateway/test_slow_servers.py::test_a_maintenance_system_that_drips_is_asked_again_and_told_in_the_status",
    ),
    "what is given up stays to be seen": (
        "gateway/test_frame.py::test_what_cannot_be_delivered_is_given_up_after_its_days_and_stays_to_be_seen",
    ),
    "routing to people": (
        "gateway/test_notify_mail.py::test_a_person_is_told_by_site_tier_condition_and_only_of_changes_of_tier",
        "gateway/test_notify_mail.py::test_quiet_hours_and_digest_hold_back_what_may_wait_and_the_limit_pierces",
        "gateway/test_notify_mail.py::test_an_alert_that_nobody_acknowledges_is_escalated_once_and_one_that_somebody_did_is_not",
    ),
    "weekly report": ("gateway/test_notify_mail.py::test_the_weekly_report_comes_on_monday_with_the_printed_page",),
    "an arm or plant that is silent": (
        "gateway/test_frame.py::test_an_arm_that_nobody_hears_for_a_day_is_told_of_once_and_its_return_too",
        "gateway/test_told_once.py::test_a_plant_whose_service_stops_is_told_once_and_so_is_its_return",
    ),
    "checks how far it gets": (
        "gateway/test_notify_mail.py::test_tls_and_password_are_used_and_the_check_says_how_far_it_gets",
        "gateway/test_ros2.py::test_a_check_tells_how_far_it_gets_and_who_listens",
        "gateway/test_opcua_server.py::test_check_says_users_certificate_and_address",
    ),
    "one gateway at a time": ("plant/test_gateway_on_either.py::test_a_second_gateway_waits_for_the_end_of_the_first",),
}

PLANT: dict[str, tuple[str, ...]] = {  # many arms
    "copies every history once": (
        "plant/test_copying.py::test_what_is_new_is_copied_and_nothing_twice",
        "plant/test_copying.py::test_a_kill_at_any_statement_loses_and_doubles_nothing",
    ),
    "SQLite or PostgreSQL": (
        "plant/test_database.py::test_the_steps_make_the_tables_that_the_code_uses",
        "plant/test_gateway_on_either.py::test_what_the_gateway_takes_and_owes_is_the_same_in_both_databases",
    ),
    "the worst first": ("plant/test_ranking.py::test_the_list_begins_with_the_worst_and_counts_everybody",),
    "enrolment with certificates": (
        "plant/test_enrolment.py::test_certificates_name_their_bearer_and_hold_for_routers_addresses",
        "plant/test_enrolment.py::test_an_authority_of_the_company_signs_and_its_key_is_not_copied",
    ),
    "roles on the bus": ("plant/test_access.py::test_each_may_do_what_its_role_says_and_nothing_else",),
    "two monitors of one name": ("plant/test_copying.py::test_two_monitors_of_one_name_are_told_and_neither_is_copied",),
    "a restored history beside the one before": (
        "plant/test_copying.py::test_a_restored_history_is_copied_beside_the_one_before_and_told",
    ),
    "metrics": (
        "publish/test_metrics.py::test_a_plant_has_few_series_an_arm",
        "publish/test_metrics.py::test_a_plant_without_its_database_says_so",
    ),
}

FILES: dict[str, tuple[str, ...]] = {  # each kind that is read, written or refused
    "configuration (TOML)": (
        "config/test_config.py::test_the_reference_configuration_holds_the_defaults",
        "config/test_config.py::test_every_mistake_is_named_at_once_with_the_nearest_valid_key",
        "config/test_config.py::test_a_reload_applies_what_can_change_and_names_what_needs_a_restart",
    ),
    "environment and credentials": (
        "config/test_config.py::test_an_environment_variable_replaces_a_key_and_is_named_in_its_mistakes",
        "config/test_config.py::test_a_secret_comes_from_the_service_managers_credentials_and_is_never_shown",
    ),
    "excitation (JSON)": (
        "config/test_config.py::test_every_shipped_excitation_starts_and_ends_at_rest_within_the_robots_limits",
        "design/test_trajectories.py::test_every_shipped_trajectory_is_proved_and_the_proof_holds_when_done_again",
        "config/test_config.py::test_a_file_that_is_no_excitation_is_refused_with_its_name",
    ),
    "cell (TOML)": (
        "design/test_clearance.py::test_a_cell_is_read_back_from_its_document_and_every_mistake_is_named",
        "design/test_clearance.py::test_the_shipped_cells_are_the_defaults",
    ),
    "arm (TOML)": (
        "identify/test_coupled_wrists.py::test_a_coupling_is_read_from_toml",
        "cli/test_commands_identify.py::test_an_exported_arm_is_an_arm_to_identify",
    ),
    "arm (URDF)": (
        "model/test_urdf.py::test_a_file_is_read_and_a_missing_one_named",
        "model/test_urdf.py::test_torque_of_any_serial_arm_equals_that_of_pinocchio",
        "model/test_urdf.py::test_faulty_files_by_an_independent_tester_are_refused",
    ),
    "recording (our Parquet)": (
        "store/test_files.py::test_our_parquet_comes_back_exactly",
        "store/test_files.py::test_anyone_can_read_our_parquet",
    ),
    "recording (Parquet of others)": (
        "store/test_files.py::test_parquet_of_others_is_read_by_its_names",
        "store/test_files.py::test_parquet_with_a_list_in_each_row_is_read_as_one_column_a_joint",
        "store/test_files.py::test_parquet_without_positions_or_numbers_is_refused",
    ),
    "recording (text)": (
        "store/test_files.py::test_every_usual_separator_and_decimal_sign_is_understood",
        "store/test_files.py::test_what_excel_writes_is_read",
        "store/test_files.py::test_a_date_and_time_is_a_time",
        "store/test_files.py::test_a_file_that_is_no_recording_is_refused_with_the_reason",
    ),
    "columns of a recording": (
        "store/test_files.py::test_columns_may_be_single_skipped_or_out_of_order",
        "cli/test_commands_production.py::test_columns_of_production_are_read_from_files",
    ),
    "manifest of a series": (
        "store/test_series.py::test_a_manifest_gives_times_payloads_and_mountings",
        "store/test_series.py::test_a_manifest_that_is_wrong_is_named_by_line_and_column",
    ),
    "identification (JSON)": (
        "identify/test_document.py::test_the_document_has_the_promised_names",
        "cli/test_commands_identify.py::test_rigid_parameters_of_an_earlier_identification_stay",
        "cli/test_commands_identify.py::test_a_file_that_is_no_identification_is_refused",
    ),
    "prior (JSON)": ("studies/test_fleet_prior.py::test_a_document_that_is_no_prior_of_this_arm_is_refused_with_the_reason",),
    "history (SQLite)": (
        "store/test_store.py::test_a_newer_history_is_refused_with_the_reason",
        "store/test_store.py::test_another_programs_database_is_refused_and_stays_unchanged",
        "store/test_store.py::test_a_history_of_before_1_0_is_refused_with_what_to_do",
        "store/test_store.py::test_commands_read_beside_the_daemon_and_get_a_message_before_the_first_run",
    ),
    "history of another arm": ("service/test_bound_history.py::test_a_history_of_another_arm_is_named_and_a_start_with_it_is_refused",),
    "belief in the history": (
        "judge/test_belief.py::test_a_damaged_belief_is_refused_with_the_name_of_its_key",
        "judge/test_belief.py::test_a_belief_of_another_schema_is_refused_with_what_to_do",
    ),
    "history in SQL": (
        "studies/test_query.py::test_the_views_hold_what_the_history_holds",
        "studies/test_query.py::test_many_histories_and_plants_are_found_below_a_folder",
    ),
    "backup of a history": (
        "service/test_backups_and_retention.py::test_a_backup_is_made_beside_a_writer_and_holds_what_was_committed",
        "service/test_backups_and_retention.py::test_a_lost_history_is_restored_from_its_backup_and_recordings_are_never_overwritten",
    ),
    "archive (folder)": (
        "store/test_archive.py::test_each_recording_goes_to_the_archive_once_and_the_history_says_where",
        "store/test_archive.py::test_pandas_and_pyarrow_read_the_archive_by_its_partitions_without_our_code",
    ),
    "archive (S3)": ("store/test_archive_s3.py::test_recordings_go_to_the_bucket_and_another_client_reads_them_by_their_partitions",),
    "scenario (TOML)": (
        "simulate/test_sim_scenarios.py::test_every_shipped_scenario_loads_and_has_a_description",
        "simulate/test_sim_scenarios.py::test_mistakes_in_a_scenario_are_named",
    ),
    "production program (TOML)": (
        "simulate/test_sim_program_tree.py::test_nodes_play_in_order_and_again_and_again",
        "simulate/test_sim_program_tree.py::test_a_wrong_node_is_named_with_what_is_expected",
    ),
    "program files of a controller": (
        "simulate/test_sim_program_files.py::test_a_file_is_found_in_the_folders_of_an_arm_and_of_the_manufacturers_simulator",
    ),
    "plant (TOML)": (
        "plant/test_settings.py::test_every_mistake_is_named_with_its_line",
        "gateway/test_frame.py::test_the_file_of_the_plant_has_the_gateway_s_sections_and_each_program_reads_its_own",
    ),
    "inventory (TOML or a spreadsheet's table)": (
        "plant/test_enrolment.py::test_mistakes_in_an_inventory_are_named_with_their_line",
        "plant/test_enrolment.py::test_a_table_of_a_spreadsheet_is_read",
    ),
    "users": ("plant/test_screen.py::test_users_are_read_as_they_are_written",),
    "plant backup": ("plant/test_backup.py::test_a_backup_that_is_damaged_or_another_programs_changes_nothing",),
    "Zenoh configuration": (
        "publish/test_security.py::test_an_invalid_zenoh_configuration_is_refused",
        "publish/test_reach.py::test_an_invalid_configuration_is_a_mistake",
    ),
    "systemd units and packages": (
        "service/test_under_systemd.py::test_the_shipped_units_pass_systemd_analyze",
        "deploy/test_package.py::test_a_package_of_an_installed_tree_holds_unit_user_and_program",
        "deploy/test_package.py::test_a_container_is_built_from_what_a_service_needs",
    ),
}

READINGS: dict[str, tuple[str, ...]] = {  # what is noticed in a recording
    "wrong units": (
        "identify/test_clean.py::test_a_wrong_unit_is_recognised_corrected_and_reported",
        "identify/test_diagnosis.py::test_currents_in_milliamperes_are_refused_with_a_hint",
        "identify/test_doubtful_readings.py::test_temperatures_in_fahrenheit_are_doubted",
    ),
    "speeds and accelerations of another signal": (
        "identify/test_speeds.py::test_speeds_that_are_another_signal_are_refused_with_the_likely_reason",
        "identify/test_doubtful_readings.py::test_accelerations_that_are_not_those_of_the_speeds_are_replaced",
    ),
    "clocks that were set, coarse or wrong": (
        "identify/test_clean.py::test_a_clock_that_was_set_costs_no_row",
        "identify/test_speeds.py::test_a_coarse_clock_is_restored",
        "identify/test_clean.py::test_a_clock_that_runs_at_another_rate_is_refused",
        "identify/test_speeds.py::test_a_clock_in_nanoseconds_is_recognised",
    ),
    "torn, missing and repeated rows": (
        "identify/test_signals.py::test_torn_rows_are_counted_by_reason_and_change_nothing",
        "identify/test_signals.py::test_a_hole_is_not_bridged",
        "identify/test_torn_rows.py::test_rows_written_twice_are_read_once",
    ),
    "spikes": ("identify/test_signals.py::test_despiking_repairs_isolated_samples_and_keeps_the_rest",),
    "sensors of temperature": (
        "identify/test_doubtful_readings.py::test_a_sensor_that_says_zero_has_no_temperature",
        "identify/test_doubtful_readings.py::test_one_torn_temperature_moves_neither_mean_nor_warming",
    ),
    "drive gains": (
        "identify/test_gain_check.py::test_a_gain_that_is_a_fifth_too_large_is_told_of_a_real_arm",
        "identify/test_gains.py::test_gains_of_a_simulated_arm_are_found_within_3_percent",
    ),
    "mounting": ("identify/test_mounting.py::test_a_simulated_arm_contradicts_every_wrong_mounting_and_no_right_one",),
    "run-in": ("identify/test_run_in.py::test_a_recording_that_is_all_run_in_is_refused_with_the_key",),
    "too little motion": (
        "identify/test_real_recordings.py::test_an_arm_that_stands_still_is_refused",
        "identify/test_real_recordings.py::test_a_staircase_of_one_joint_is_refused",
    ),
    "every code has its test": (
        "identify/test_what_it_notices.py::test_every_code_in_the_table_is_said_by_the_program_and_held_by_a_test",
        "identify/test_what_it_notices.py::test_every_detector_of_a_recordings_units_and_signals_is_in_the_table",
    ),
}

IDENTIFICATION: dict[str, tuple[str, ...]] = {  # what is identified
    "ordinary and weighted least squares": (
        "identify/test_solve.py::test_without_noise_the_parameters_of_the_arm_are_found",
        "identify/test_real_recordings.py::test_ur10e_torque_is_predicted_to_9_5_6_8_8_7_percent",
    ),
    "robust": ("identify/test_robust.py::test_five_percent_of_gross_outliers_do_not_move_a_robust_fit",),
    "physically consistent": ("identify/test_physically_consistent.py::test_constraints_bind_where_least_squares_is_not_physical",),
    "selection of a law": ("identify/test_laws.py::test_auto_selects_the_papers_law_where_it_is_right_and_a_richer_one_elsewhere",),
    "intervals": ("identify/test_coverage.py::test_ninety_percent_intervals_hold_the_truth_in_a_small_sample",),
    "payload": (
        "identify/test_laws.py::test_a_payload_is_found_with_arm_and_friction_frozen",
        "identify/test_real_recordings.py::test_ur10e_payload_is_found_with_the_arm_and_its_friction_frozen",
    ),
    "frozen rigid parameters": ("identify/test_laws.py::test_frozen_rigid_parameters_are_kept_and_steady_friction",),
    "several recordings": ("identify/test_together.py::test_sweeps_of_single_joints_identify_the_friction_of_the_arm_together",),
    "long recordings": ("identify/test_together.py::test_a_long_recording_takes_no_table_of_all_its_rows",),
    "coupled wrists": ("identify/test_coupled_wrists.py::test_friction_of_coupled_motors_comes_back",),
    "gear ripple": ("identify/test_ripple.py::test_known_ripple_is_within_its_deviation",),
    "production": (
        "identify/test_production_of_real_arms.py::test_intervals_of_production_hold_what_the_other_run_finds_itself",
        "identify/test_production.py::test_contact_is_left_out_by_torque_alone",
        "identify/test_production_cells.py::test_a_tool_that_drags_where_one_joint_moves_alone_is_no_friction_of_that_joint",
    ),
    "base parameters": (
        "model/test_base.py::test_52_parameters_show_where_joint_1_is_upright_and_54_on_a_wall",
        "model/test_base_closed_form.py::test_every_coefficient_equals_its_closed_form",
    ),
    "a law is one entry": ("identify/test_new_friction_law.py::test_identify_prints_and_validates_the_new_law",),
}

FRICTION_LAWS: dict[str, tuple[str, ...]] = {  # each of `model.friction`
    "paper": ("identify/test_laws.py::test_fc_and_fv_of_a_rich_law_are_those_the_paper_would_have_found",),
    "load": (
        "model/test_friction.py::test_a_law_with_load_refuses_a_missing_load",
        "identify/test_real_recordings.py::test_ur10e_chooses_load_concave_and_braking_friction",
    ),
    "concave": ("identify/test_laws.py::test_the_residual_friction_is_that_of_the_concave_law",),
    "stribeck": ("identify/test_laws.py::test_without_noise_the_parameters_of_a_rich_law_are_found",),
    "braking": ("model/test_friction.py::test_the_share_of_braking_counts_where_the_load_drives_the_joint",),
}

OBJECTIVES: dict[str, tuple[str, ...]] = {  # each of `design.objective`
    "friction": (
        "design/test_figures.py::test_the_friction_objective_beats_the_condition_number_on_the_simulated_arm",
        "design/test_trajectories.py::test_a_search_improves_and_returns_its_best_when_it_is_stopped",
    ),
    "condition": ("design/test_curve_and_objective.py::test_the_figures_of_merit_are_their_definitions",),
    "scaled": ("design/test_curve_and_objective.py::test_the_figures_of_merit_are_their_definitions",),
    "dopt": ("design/test_curve_and_objective.py::test_the_figures_of_merit_are_their_definitions",),
}

SCENARIOS: dict[str, tuple[str, ...]] = {  # each of config/scenarios
    "fresh": ("simulate/test_sim_scenarios.py::test_every_shipped_scenario_loads_and_has_a_description",),
    "joint-wearing": ("simulate/test_sim_scenarios.py::test_a_joint_wears_five_percent_a_month",),
    "step-wear": ("simulate/test_sim_scenarios.py::test_step_wear_comes_from_one_moment_to_the_next",),
    "cold-mondays": ("simulate/test_sim_scenarios.py::test_monday_morning_is_colder_than_friday_evening",),
    "hot-summer": ("simulate/test_sim_scenarios.py::test_a_hot_summer_is_hot_in_the_afternoon",),
    "payload-undeclared": ("simulate/test_sim_scenarios.py::test_a_payload_comes_undeclared",),
    "remounted": ("simulate/test_sim_scenarios.py::test_the_arm_hangs_from_the_ceiling_and_the_controller_does_not_know",),
    "regreased": ("simulate/test_sim_scenarios.py::test_grease_takes_most_of_the_wear_away",),
    "joint-replaced": ("simulate/test_sim_scenarios.py::test_a_replaced_joint_has_its_own_serial_and_friction",),
    "noisy-currents": ("simulate/test_sim_scenarios.py::test_noisy_currents_have_four_times_the_noise",),
    "long-holiday": ("simulate/test_sim_scenarios.py::test_on_holiday_the_arm_rests",),
    "try": ("simulate/test_sim_scenarios.py::test_every_shipped_scenario_loads_and_has_a_description",),
}

SIMULATOR: dict[str, tuple[str, ...]] = {  # the controller made of software
    "unmodified ur-rtde": (
        "simulate/test_sim_conformance.py::test_the_control_and_receive_clients_agree_with_every_call",
        "simulate/test_sim_following.py::test_control_moves_streams_and_answers",
    ),
    "the manufacturer's client and urx": (
        "simulate/test_sim_judges.py::test_the_manufacturers_own_rtde_client_productions",
        "simulate/test_sim_judges.py::test_urx_reads_the_secondary_and_the_realtime_port_and_moves_the_arm",
    ),
    "dashboard": ("simulate/test_sim_conformance.py::test_the_dashboard_client_gets_an_answer_to_every_command",),
    "primary, secondary and real-time port": (
        "simulate/test_sim_state_bytes.py::test_a_robot_state_message_has_the_published_packages",
        "simulate/test_sim_state_bytes.py::test_a_realtime_packet_has_every_field_at_its_published_place",
    ),
    "Robot API of a PolyScope X": (
        "simulate/test_sim_polyscope_x.py::test_each_version_has_the_endpoints_that_the_manufacturers_client_asks_it_for",
        "simulate/test_sim_polyscope_x.py::test_unmodified_ur_rtde_uploads_its_script_and_moves_the_arm",
    ),
    "programs in URScript": (
        "simulate/test_sim_language.py::test_a_program_computes_branches_and_calls_its_own_functions",
        "simulate/test_sim_language.py::test_threads_take_turns_and_share_global_variables",
        "simulate/test_sim_scripts.py::test_a_name_that_a_version_does_not_know_refuses_the_whole_program",
    ),
    "program trees and files": (
        "simulate/test_sim_program_tree.py::test_nodes_play_in_order_and_again_and_again",
        "simulate/test_sim_program_files.py::test_a_program_file_is_loaded_played_paused_and_stopped_under_its_name",
    ),
    "lending node": ("simulate/test_sim_hand_over.py::test_ur_rtde_borrows_the_arm_and_the_program_goes_on",),
    "physics": (
        "simulate/test_sim_physics.py::test_equations_are_solved_by_scipys_own_function",
        "simulate/test_sim_physics.py::test_the_production_of_the_drives_is_heat_and_energy_in_any_replay",
    ),
    "temperatures and wear": (
        "simulate/test_sim_physics.py::test_half_an_hour_of_motion_warms_a_joint_by_twelve_to_seventeen_kelvin",
        "simulate/test_sim_physics.py::test_wear_grows_with_use_under_load",
    ),
    "safety system": (
        "simulate/test_sim_safety.py::test_beyond_the_limits_the_arm_protects_itself",
        "simulate/test_sim_safety.py::test_an_emergency_stop_takes_the_power_and_the_dashboard_brings_it_back",
    ),
    "production cells": (
        "simulate/test_sim_cells.py::test_every_cell_fits_every_arm",
        "simulate/test_sim_cells.py::test_a_hand_leads_the_arm_in_freedrive_while_the_program_plays",
    ),
    "personalities": ("simulate/test_sim_personality.py::test_an_arm_as_recorded_stands_as_the_recorded_ones_did",),
    "equal seeds, equal bits": (
        "simulate/test_sim_stepped.py::test_equal_seeds_give_equal_recordings_bit_for_bit",
        "simulate/test_sim_wire.py::test_real_time_and_stepped_measurements_are_equal",
    ),
    "faults by command line and command port": (
        "simulate/test_sim_faults.py::test_an_emergency_stop_through_the_command_line",
        "simulate/test_sim_wire.py::test_the_command_port_plays_advances_and_answers",
    ),
}

SIMULATED_FAULTS: dict[str, tuple[str, ...]] = {  # each fault of the simulator; the matrix survives every one at every moment of a replay
    "stall": (
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
        "acquire/test_fault_matrix.py::test_a_sample_of_faults_in_the_middle_of_a_replay_stops_the_arm_and_is_named",
    ),
    "close": (
        "simulate/test_sim_faults.py::test_connections_of_each_service_can_be_closed_and_reset",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "reset": (
        "simulate/test_sim_faults.py::test_connections_of_each_service_can_be_closed_and_reset",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "listener_gone": (
        "simulate/test_sim_faults.py::test_a_listener_goes_away_and_comes_back",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "restart": (
        "simulate/test_sim_faults.py::test_a_restarted_controller_begins_its_clock_anew",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "power_cut": (
        "simulate/test_sim_faults.py::test_a_controller_without_power_is_gone_and_comes_back_without_power",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "freeze": (
        "simulate/test_sim_faults.py::test_a_frozen_controller_keeps_its_connections_and_loses_time",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "late": (
        "simulate/test_sim_faults.py::test_late_packets_come_in_a_bunch_and_in_order",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "skip": (
        "simulate/test_sim_faults.py::test_skipped_packets_are_missing_from_the_clock",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "mute": (
        "simulate/test_sim_faults.py::test_a_mute_controller_accepts_and_sends_nothing",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "robot_api": (
        "acquire/test_polyscope_x.py::test_a_robot_api_that_fails_in_the_middle_ends_the_motion_and_the_arm_comes_to_rest",
        "simulate/test_sim_polyscope_x.py::test_a_faulty_robot_api_answers_so_until_the_fault_is_cleared",
    ),
    "manual_mode": (
        "acquire/test_polyscope_x.py::test_a_stop_or_a_lost_connection_ends_the_motion_by_its_cause",
        "simulate/test_sim_polyscope_x.py::test_in_local_control_everything_is_told_and_nothing_is_done",
    ),
    "text_at_connect": (
        "simulate/test_sim_faults.py::test_a_text_message_at_connect_comes_before_the_first_reply",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "registers_in_use": (
        "simulate/test_sim_faults.py::test_registers_are_held_by_somebody_who_is_gone",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "version": (
        "simulate/test_sim_faults.py::test_another_version_and_missing_outputs_are_reported",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "not_found": (
        "simulate/test_sim_faults.py::test_another_version_and_missing_outputs_are_reported",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "remote": (
        "simulate/test_sim_faults.py::test_remote_control_off_is_reported",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "digital_input": (
        "cli/test_commands_motion.py::test_a_digital_input_is_a_permit",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "foreign_program": (
        "simulate/test_sim_interference.py::test_somebody_elses_program_starts_after_ours_has_ended",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "teach_button": (
        "simulate/test_sim_interference.py::test_the_freedrive_button_shows_in_the_status_bits_and_nowhere_else",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "speed_slider": (
        "simulate/test_sim_interference.py::test_the_slider_at_the_pendant_scales_moves_and_is_published",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "tcp_changed": (
        "simulate/test_sim_interference.py::test_changes_at_the_pendant_are_published_and_undone_by_clear",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "payload_changed": (
        "simulate/test_sim_interference.py::test_changes_at_the_pendant_are_published_and_undone_by_clear",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "wrist_turned": (
        "simulate/test_sim_interference.py::test_a_wrist_turned_by_a_turn_stands_where_it_stood_and_says_another_angle",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "reduced": (
        "simulate/test_sim_interference.py::test_in_the_reduced_safety_mode_the_arm_moves_on",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "stuck": (
        "simulate/test_sim_interference.py::test_a_stuck_joint_stands_at_once_and_the_others_go_on_until_the_protective_stop",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "brake": (
        "simulate/test_sim_interference.py::test_a_closed_brake_shows_in_the_mode_of_its_joint",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "watchdog_dead": (
        "simulate/test_sim_interference.py::test_a_dead_watchdog_lets_the_program_play_on_without_targets",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "never_ready": ("acquire/test_idle_faults.py::test_our_program_that_takes_no_command_is_stopped_and_the_call_that_blocked_is_named",),
    "clock_jump": (
        "simulate/test_sim_interference.py::test_the_published_clock_jumps_and_the_arm_does_not",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "program_stop": (
        "simulate/test_sim_faults.py::test_somebody_else_stops_the_program",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "protective_stop": (
        "simulate/test_sim_faults.py::test_a_protective_stop_comes_in_each_observed_variant",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "safeguard_stop": (
        "simulate/test_sim_interference.py::test_when_the_guard_is_closed_again_the_program_plays_on_by_itself",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "emergency_stop": (
        "simulate/test_sim_safety.py::test_an_emergency_stop_takes_the_power_and_the_dashboard_brings_it_back",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "emergency_release": (
        "simulate/test_sim_safety.py::test_an_emergency_stop_takes_the_power_and_the_dashboard_brings_it_back",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "temperatures_frozen": (
        "simulate/test_sim_faults.py::test_frozen_temperatures_stay_until_clear",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "temperature_glitch": (
        "simulate/test_sim_faults.py::test_a_glitching_temperature_is_wrong_now_and_then",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "current_stuck": (
        "simulate/test_sim_faults.py::test_a_stuck_current_sensor_shows_the_same_current",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "encoder_offset": (
        "simulate/test_sim_faults.py::test_an_encoder_offset_shifts_what_is_measured_and_moves_nothing",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "current_noise": (
        "simulate/test_sim_faults.py::test_noisier_currents_are_noisier",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "obstacle": (
        "simulate/test_sim_faults.py::test_an_obstacle_is_borne_by_the_drive_until_it_is_gone",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "backlash": (
        "simulate/test_sim_damage.py::test_play_is_crossed_where_the_load_changes_its_side",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "soft_gear": (
        "simulate/test_sim_damage.py::test_a_gear_yields_as_much_as_its_stiffness_says",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "kinematic_error": (
        "simulate/test_sim_damage.py::test_a_kinematic_error_is_a_wave_of_two_periods_a_turn_of_the_motor",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "bearing": (
        "simulate/test_sim_damage.py::test_balls_that_pass_a_defect_brake_so_often_as_geometry_says",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "aged_lubricant": (
        "simulate/test_sim_damage.py::test_spent_grease_rubs_more_when_slow_and_less_when_fast",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "dragging_brake": (
        "simulate/test_sim_damage.py::test_a_dragging_brake_rubs_whatever_load_and_temperature_are",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "joint_encoder": (
        "simulate/test_sim_damage.py::test_an_encoder_off_its_centre_misreads_once_a_turn",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "motor_encoder": (
        "simulate/test_sim_damage.py::test_an_encoder_off_its_centre_misreads_once_a_turn",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "demagnetisation": (
        "simulate/test_sim_damage.py::test_heat_weakens_magnets_for_good",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "recover": ("studies/test_trial.py::test_a_stop_in_a_trial_ends_as_on_a_real_arm_and_is_over_when_somebody_has_recovered_the_arm",),
    "clear": (
        "simulate/test_sim_absurd.py::test_clear_restores_the_noise_of_the_settings",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
}

SURVIVED: dict[str, tuple[str, ...]] = {  # what happens to the monitor and its plant, and what is lost: nothing
    "kills in mid motion": (
        "acquire/test_kills.py::test_three_kills_at_random_moments_leave_a_standing_arm",
        "service/test_daemon_kills.py::test_a_hundred_kills_leave_a_standing_arm_and_a_correct_history",
        "service/test_daemon.py::test_sigkill_during_a_replay_stops_the_arm_and_the_ledger_has_it_as_aborted",
    ),
    "kills over weeks": (
        "service/test_kill_weeks.py::test_a_few_kills_over_simulated_weeks_leave_a_correct_history",
        "service/test_kill_weeks.py::test_two_hundred_kills_over_simulated_weeks_leave_a_correct_history",
        "store/test_store.py::test_sigkill_at_any_moment_loses_and_repeats_nothing",
    ),
    "cuts of single connections": (
        "acquire/test_cuts.py::test_a_sample_of_cuts_of_single_connections_stops_the_arm_for_good",
        "acquire/test_cuts.py::test_five_hundred_cuts_of_each_connection_never_make_an_arm_go_on",
    ),
    "faults of the controller": (
        "acquire/test_fault_matrix.py::test_a_sample_of_faults_in_the_middle_of_a_replay_stops_the_arm_and_is_named",
        "acquire/test_fault_matrix.py::test_every_fault_at_every_moment_of_a_replay_is_survived",
    ),
    "faults while the arm is lent": (
        "acquire/test_lending_soak.py::test_two_hundred_cycles_with_twenty_replays_go_on_at_the_next_node",
        "acquire/test_lending_soak.py::test_each_fault_at_each_phase_of_a_borrowed_arm",
        "acquire/test_borrowed_arm.py::test_a_monitor_that_hangs_while_it_has_the_arm_gives_it_back",
        "acquire/test_borrowed_arm.py::test_a_dead_child_in_local_control_stops_arm_and_program",
    ),
    "what happens at the controller": (
        "acquire/test_happenings.py::test_whatever_happens_at_the_controller_has_its_cause_and_nothing_of_ours_begins_again",
        "acquire/test_arms_as_recorded.py::test_the_freedrive_button_ends_a_motion_and_forbids_the_next",
    ),
    "what stands against a motion": (
        "acquire/test_idle_faults.py::test_what_stands_against_a_motion_refuses_it_by_its_condition_and_nothing_starts",
    ),
    "a busy machine": (
        "acquire/test_watching.py::test_a_parent_that_was_busy_itself_does_not_blame_its_child",
        "acquire/test_torque_band_of_arms.py::test_late_targets_jolt_the_arm_and_do_not_leave_the_band",
    ),
    "power cut of the host": (
        "service/test_motion.py::test_sigkill_or_a_power_cut_in_mid_motion_waits_for_a_person",
        "service/test_backups_and_retention.py::test_entries_lost_with_a_torn_log_are_detected_and_no_recording_is_overwritten",
    ),
    "full or read-only disk": (
        "service/test_scheduler.py::test_with_a_full_disk_nothing_moves_and_the_problem_ends_when_there_is_room",
        "service/test_scheduler.py::test_a_disk_that_becomes_read_only_is_reported_and_survived",
        "service/test_motion.py::test_a_full_disk_keeps_the_arm_where_it_is_or_asks_for_a_person",
        "service/test_daemon_faults.py::test_the_daemon_waits_at_its_start_for_room_on_the_disk",
    ),
    "damaged history": (
        "service/test_backups_and_retention.py::test_a_damaged_history_is_set_aside_and_the_newest_good_backup_takes_its_place",
        "service/test_backups_and_retention.py::test_a_damaged_history_without_a_backup_is_kept_and_a_new_one_begins",
    ),
    "clocks that are set": (
        "service/test_scheduler.py::test_a_clock_set_back_repeats_no_window_and_one_set_forward_waits_before_it_counts",
        "service/test_scheduler.py::test_before_the_clock_has_been_set_nothing_is_replayed",
        "service/test_scheduler.py::test_replays_of_a_clock_that_was_a_year_ahead_are_rejected_automatically",
        "service/test_housekeeping.py::test_a_clock_behind_the_history_is_a_problem_until_it_has_caught_up",
    ),
    "router that is away": ("publish/test_bus.py::test_a_missing_router_is_reported_and_joined_when_it_starts",),
    "arm that is away": (
        "service/test_tries.py::test_an_arm_that_is_not_reached_is_tried_again_while_the_window_is_open",
        "acquire/test_child.py::test_a_listener_waits_longer_after_each_failure_and_reports_why",
    ),
    "archive that is away": (
        "store/test_archive.py::test_an_archive_that_is_away_is_a_problem_after_some_tries_and_over_when_it_is_back",
        "store/test_archive_s3.py::test_a_server_that_is_away_for_a_while_gets_everything_when_it_is_back",
    ),
    "archive and kills": (
        "store/test_archive.py::test_a_monitor_killed_between_upload_and_note_sends_nothing_under_a_second_name",
        "service/test_archive_soak.py::test_a_daemon_that_is_killed_again_and_again_loses_and_doubles_nothing",
    ),
    "a computation that dies": (
        "service/test_apart.py::test_a_replay_whose_verdict_died_is_kept_told_and_assessed_later",
        "service/test_apart.py::test_a_recording_that_kills_every_process_is_rejected_so_that_later_ones_are_learnt_from",
    ),
    "a hanging daemon": (
        "service/test_under_systemd.py::test_a_daemon_that_hangs_is_ended_and_started_again",
        "service/test_systemd.py::test_the_watchdog_is_notified_while_every_worker_is_alive_and_not_when_one_is_late",
    ),
    "errors of this program": ("service/test_daemon_faults.py::test_an_exception_during_a_replay_ends_the_window_and_waits_for_a_person",),
    "many restarts": (
        "service/test_under_systemd.py::test_systemd_never_gives_the_service_up",
        "publish/test_restarts.py::test_a_hundred_restarts_lose_and_repeat_no_transition",
    ),
    "reloads, right and wrong": ("service/test_under_systemd.py::test_a_reload_takes_a_valid_configuration_and_refuses_an_invalid_one",),
    "plant, router and database killed": (
        "plant/test_on_the_bus.py::test_fifty_kills_of_plant_router_and_database",
        "plant/test_fifty_kills.py::test_a_kill_of_each_loses_doubles_and_swaps_nothing",
        "plant/test_on_the_bus.py::test_a_database_that_is_killed_is_waited_for",
    ),
    "the plant that leads killed beside its standby": (
        "plant/test_standby.py::test_a_plant_that_is_killed_is_taken_over_within_half_a_minute",
        "plant/test_standby.py::test_the_screen_of_the_standby_shows_every_arm_and_its_commands_reach_them",
    ),
    "gateway killed and servers away": (
        "plant/test_everything_killed_soak.py::test_one_mail_and_one_ticket_an_alert_over_a_hundred_restarts_of_everything_and_a_day_s_outage",
        "gateway/test_frame.py::test_a_transition_is_offered_once_over_restarts_and_what_was_before_the_gateway_is_told_to_nobody",
    ),
    "malformed queries": (
        "publish/test_malformed.py::test_every_generated_malformed_query_gets_an_error",
        "publish/test_malformed.py::test_a_hundred_thousand_malformed_queries_each_get_an_error",
    ),
    "malformed requests of a browser": (
        "views/test_page_server.py::test_a_thousand_malformed_requests_do_no_harm",
        "views/test_page_server.py::test_browsers_that_never_read_hold_up_nobody_else",
    ),
    "memory over many replays": (
        "publish/test_ten_thousand_replays.py::test_ten_thousand_replays_do_not_grow_memory",
        "service/test_production_listener.py::test_a_month_of_production_takes_no_more_memory_than_a_week_of_it",
        "service/test_production_listener.py::test_a_thread_that_is_late_loses_blocks_and_no_memory",
    ),
    "production over a kill": ("service/test_production_listener.py::test_a_kill_costs_the_last_minutes_and_no_day_is_judged_twice",),
    "a study's workers killed": (
        "studies/test_reassess_kills.py::test_killed_workers_and_a_killed_scheduler_lose_only_what_was_under_way",
        "studies/test_reassess_kills.py::test_ctrl_c_keeps_what_is_finished_and_leaves_no_process",
        "studies/test_reassess_on_two_hosts.py::test_two_hosts_without_a_common_disk_say_what_this_machine_says_though_one_is_killed",
    ),
}

PROBLEMS: dict[str, tuple[str, ...]] = {  # what the monitor says of itself
    "disk": ("service/test_scheduler.py::test_with_a_full_disk_nothing_moves_and_the_problem_ends_when_there_is_room",),
    "store": ("service/test_scheduler.py::test_while_the_store_fails_nothing_moves_and_it_is_tried_again",),
    "stop": ("service/test_housekeeping.py::test_a_stop_is_a_problem_until_a_person_has_checked_the_arm",),
    "away": ("service/test_left_arm.py::test_windows_that_are_refused_because_the_arm_stands_elsewhere_are_a_problem_from_the_first_on",),
    "nothing_learnt": ("service/test_own_alerts.py::test_thirty_five_days_without_a_verdict_are_no_green_normal",),
    "assessment": ("service/test_apart.py::test_a_replay_whose_verdict_died_is_kept_told_and_assessed_later",),
    "restored": (
        "publish/test_restored_history.py::test_a_restored_history_without_a_verdict_is_a_problem_and_an_alert_with_the_first_verdict",
    ),
    "clock": ("service/test_scheduler.py::test_before_the_clock_has_been_set_nothing_is_replayed",),
    "clock_behind": ("service/test_housekeeping.py::test_a_clock_behind_the_history_is_a_problem_until_it_has_caught_up",),
    "arm": ("service/test_own_alerts.py::test_an_arm_that_is_not_heard_is_an_alert_after_two_windows_and_it_survives_restarts",),
    "router": ("publish/test_bus.py::test_a_missing_router_is_reported_and_joined_when_it_starts",),
    "backup, retention, rewind, fault": ("service/test_daemon_faults.py::test_what_cannot_be_finished_at_the_start_is_finished_later",),
    "archive": ("store/test_archive.py::test_another_content_under_the_name_is_told_and_never_overwritten",),
}

SERVICE: dict[str, tuple[str, ...]] = {  # what the daemon does besides replays
    "housekeeping: backups and pruning": (
        "service/test_backups_and_retention.py::test_backups_keep_the_newest_of_each_day_and_no_more_days_than_asked",
        "service/test_backups_and_retention.py::test_recordings_are_pruned_by_age_and_by_size_and_their_verdicts_stay",
    ),
    "inspection by date and hours": (
        "service/test_inspection.py::test_a_check_is_due_by_date_or_by_hours_whichever_comes_first",
        "service/test_inspection.py::test_the_manufacturers_checks_are_named_with_their_source_and_an_item_replaces_an_interval",
    ),
    "operating hours and stops": (
        "service/test_inspection.py::test_hours_are_counted_while_rows_come_and_a_gap_counts_for_nothing",
        "service/test_inspection.py::test_a_stop_counts_once_however_often_it_is_heard_and_over_a_restart",
    ),
    "errors of the controller": ("service/test_inspection.py::test_errors_come_over_the_primary_port_and_again_after_it_was_lost",),
    "production day by day": (
        "service/test_production_listener.py::test_a_day_of_production_is_judged_after_midnight_and_enters_the_history_with_the_state",
    ),
    "systemd: notify, watchdog, journal": (
        "service/test_under_systemd.py::test_it_starts_reports_its_state_and_runs_as_an_unprivileged_user",
        "service/test_systemd.py::test_the_journal_gets_searchable_fields",
        "service/test_under_systemd.py::test_it_writes_nothing_outside_its_own_directories",
    ),
}

CAPABILITIES: dict[str, dict[str, tuple[str, ...]]] = {
    "commands": COMMANDS,
    "use_of_the_commands": USE_OF_THE_COMMANDS,
    "pages": PAGES,
    "use_of_the_pages": USE_OF_THE_PAGES,
    "report": REPORT,
    "documents": DOCUMENTS,
    "bus": BUS,
    "alerts": ALERTS,
    "verdicts": VERDICTS,
    "motion_conditions": MOTION_CONDITIONS,
    "motion": MOTION,
    "ends_of_a_motion": ENDS_OF_A_MOTION,
    "channels": CHANNELS,
    "gateway": GATEWAY,
    "plant": PLANT,
    "files": FILES,
    "readings": READINGS,
    "identification": IDENTIFICATION,
    "friction_laws": FRICTION_LAWS,
    "objectives": OBJECTIVES,
    "scenarios": SCENARIOS,
    "simulator": SIMULATOR,
    "simulated_faults": SIMULATED_FAULTS,
    "survived": SURVIVED,
    "problems": PROBLEMS,
    "service": SERVICE,
}
