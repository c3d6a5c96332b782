//! The gRPC methods that exist, for labels of metrics and logs: any other name comes from the caller, who could fill memory with
//! new ones.

use std::{collections::HashMap, sync::LazyLock};

use prost::Message;
use prost_types::FileDescriptorSet;

/// Names of methods by the path of a request, from the descriptors of the protocol, of health and of reflection.
static METHODS: LazyLock<HashMap<String, String>> = LazyLock::new(|| {
    let sets = [moldline_proto::FILE_DESCRIPTOR_SET, tonic_health::pb::FILE_DESCRIPTOR_SET];
    let files = sets.iter().filter_map(|set| FileDescriptorSet::decode(*set).ok()).flat_map(|set| set.file);
    let mut methods = HashMap::new();
    for file in files {
        for service in &file.service {
            for method in &service.method {
                let path = format!("/{}.{}/{}", file.package(), service.name(), method.name());
                methods.insert(path, method.name().to_owned());
            }
        }
    }
    for version in ["v1", "v1alpha"] {
        let name = "ServerReflectionInfo";
        methods.insert(format!("/grpc.reflection.{version}.ServerReflection/{name}"), name.to_owned());
    }
    methods
});

/// The name of the method at a path; `None` if there is no such method.
pub fn name_of(path: &str) -> Option<&'static str> {
    METHODS.get(path).map(String::as_str)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_methods_of_the_descriptors_have_names() {
        assert_eq!(name_of("/moldline.v1.MeshService/Deform"), Some("Deform"));
        assert_eq!(name_of("/moldline.v1.PanelService/Analyze"), Some("Analyze"));
        assert_eq!(name_of("/grpc.health.v1.Health/Check"), Some("Check"));
        for path in
            ["/moldline.v1.MeshService/Anything", "/moldline.v1.MeshService/", "/Deform", "Deform", ""]
        {
            assert_eq!(name_of(path), None, "{path}");
        }
    }
}
