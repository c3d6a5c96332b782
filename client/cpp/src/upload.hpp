// A set-up's files as messages.
#pragma once

#include <filesystem>
#include <functional>
#include <vector>

#include "moldline/v1/mesh_service.pb.h"

namespace moldline::internal {

/// The files to send, after they have been entered in the header: an archive, or all of a folder but hidden ones.
std::vector<std::filesystem::path> files(const std::filesystem::path& path, v1::SetupHeader& header);

/// Sends the header, then the files' bytes, until `send` says that nobody takes them any more. Throws
/// `std::invalid_argument` if a file cannot be read.
void upload(
    const v1::SetupHeader& header, const std::vector<std::filesystem::path>& files,
    const std::function<bool(const v1::CreateSetupRequest&)>& send);

}  // namespace moldline::internal
