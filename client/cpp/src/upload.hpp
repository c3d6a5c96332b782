// Upload of a set-up's files.
#pragma once

#include <filesystem>
#include <functional>
#include <vector>

#include "moldline/v1/mesh_service.pb.h"

namespace moldline::internal {

/// Enters the files to send in the header: an archive, or all files of a folder except hidden ones and Python's caches.
std::vector<std::filesystem::path> files(const std::filesystem::path& path, v1::SetupHeader& header);

/// Sends the header, then the files' bytes, until `send` returns false: the call has ended. Throws
/// `std::invalid_argument` if a file cannot be read.
void upload(
    const v1::SetupHeader& header, const std::vector<std::filesystem::path>& files,
    const std::function<bool(const v1::CreateSetupRequest&)>& send);

}  // namespace moldline::internal
